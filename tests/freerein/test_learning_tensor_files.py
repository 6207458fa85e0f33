import contextlib
import json
import pickle
import struct

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from freerein.errors import InvalidInput
from freerein.learning import tensor_files

TENSORS = {"b": torch.arange(6.0).reshape(2, 3), "a": torch.tensor(7), "empty": torch.zeros(0, 3)}
FILE = tensor_files.dump(TENSORS)


def with_header(header: bytes, length: int | None = None) -> bytes:
    return struct.pack("<Q", len(header) if length is None else length) + header


def test_tensors_come_back_with_dtype_and_shape() -> None:
    found = tensor_files.parse(FILE)
    assert {name: (each.dtype, each.shape) for name, each in found.items()} == {
        name: (each.dtype, each.shape) for name, each in TENSORS.items()
    }
    assert torch.equal(found["b"], TENSORS["b"])


def test_the_same_tensors_give_the_same_bytes_wherever_they_lie_in_memory() -> None:
    turned = {"empty": TENSORS["empty"], "a": TENSORS["a"], "b": TENSORS["b"].T.contiguous().T}
    assert tensor_files.dump(turned) == FILE


@pytest.mark.fault("O13")
@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\0" * 7,
        with_header(b"", length=2**63),
        with_header(b" " * (tensor_files.MAX_HEADER_BYTES + 1)),
        with_header(b"{"),
        with_header(b"[]"),
        with_header(b"[" * 100_000),
        with_header(json.dumps({str(i): {} for i in range(tensor_files.MAX_ENTRIES + 1)}).encode()),
        with_header(json.dumps({"a": {"dtype": "F32", "shape": [2**40], "data_offsets": [0, 2**42]}}).encode()),
        pickle.dumps({"weights": [1.0]}),
    ],
)
def test_what_is_not_safetensors_or_over_a_cap_is_refused(data: bytes) -> None:
    with pytest.raises(InvalidInput, match="safetensors file"):
        tensor_files.parse(data)


@pytest.mark.fault("O13")
@given(st.integers(0, len(FILE) - 1), st.integers(1, 255))
def test_a_changed_byte_is_refused_or_read_but_never_a_crash(place: int, change: int) -> None:
    data = FILE[:place] + bytes([FILE[place] ^ change]) + FILE[place + 1 :]
    with contextlib.suppress(InvalidInput):
        tensor_files.parse(data)
