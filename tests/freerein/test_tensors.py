"""Arrays on a wire: nothing that the header says is believed before it is checked."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from freerein import tensors
from freerein.errors import InvalidInput

ARRAYS = st.sampled_from(sorted(tensors.DTYPES)).flatmap(
    lambda name: hnp.arrays(tensors.DTYPES[name], hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4))
)


@given(ARRAYS)
def test_every_array_comes_back_as_it_went(array: npt.NDArray[np.generic]) -> None:
    back = tensors.decode(*tensors.encode(array))
    assert back.dtype == array.dtype
    assert back.shape == array.shape
    np.testing.assert_array_equal(back, array)


@given(
    st.sampled_from([*tensors.DTYPES, "FP16", "uint8", ""]),
    st.lists(st.integers(-(2**63), 2**63 - 1) | st.integers(0, 4), max_size=10),
    st.binary(max_size=64),
)
def test_whatever_a_header_says_the_answer_is_an_array_of_those_bytes_or_invalid_input(
    name: str, shape: list[int], raw: bytes
) -> None:
    try:
        outcome = tensors.decode(name, shape, raw, field="actions")
    except InvalidInput as error:
        outcome = error
    if isinstance(outcome, InvalidInput):
        assert outcome.field == "actions"
        assert outcome.hint
    else:
        assert outcome.tobytes() == raw
        assert outcome.shape == tuple(shape)


@pytest.mark.fault("I2")
@pytest.mark.parametrize(
    ("shape", "raw"),
    [
        ([1_000_000_000], b"\0"),  # nothing is broadcast
        ([2**32, 2**32], b""),  # a product that overflows 64 bits
        ([2**62, 0], b""),
        ([-1], b"\0"),
        ([-1, -1], b"\0"),
        ([1] * 9, b"\0"),
        ([2], b"\0"),
        ([1], b"\0\0"),
        ([], b""),
        ([0], b"\0"),
        ([0, 2**31], b""),
    ],
)
def test_a_shape_that_lies_is_refused(shape: list[int], raw: bytes) -> None:
    with pytest.raises(InvalidInput, match="actions"):
        tensors.decode("UINT8", shape, raw, field="actions")


@pytest.mark.parametrize(("shape", "raw"), [([1] * 8, b"\0"), ([0, 2**31 - 1], b"")])
def test_a_shape_of_just_the_limit_is_one(shape: list[int], raw: bytes) -> None:
    assert tensors.decode("UINT8", shape, raw).shape == tuple(shape)


@pytest.mark.parametrize("name", ["BOOL", "UINT8", "UINT16", "UINT32", "INT32", "INT64", "FP32", "FP64"])
def test_a_name_is_that_of_the_open_inference_protocol(name: str) -> None:
    kind = name.replace("FP", "float").replace("INT", "int").replace("U", "u").lower()
    assert tensors.datatype(np.zeros(1, kind)) == name


@pytest.mark.parametrize(
    ("array", "name", "raw"),
    [
        (np.array([True, False]), "BOOL", b"\1\0"),
        (np.array(258, ">u2"), "UINT16", b"\2\1"),
        (np.array([1.0], ">f4"), "FP32", b"\0\0\x80\x3f"),
        (np.arange(6, dtype=np.uint8).reshape(2, 3).T, "UINT8", b"\0\3\1\4\2\5"),
        (np.array([1], np.longlong), "INT64", b"\1" + b"\0" * 7),
    ],
)
def test_elements_go_in_c_order_little_endian(array: npt.NDArray[np.generic], name: str, raw: bytes) -> None:
    assert tensors.encode(array) == (name, array.shape, raw)


@pytest.mark.parametrize("dtype", ["f2", "c8", "U3", "O", "M8[s]", "i1"])
def test_a_dtype_without_a_name_is_refused_by_its_name(dtype: str) -> None:
    with pytest.raises(InvalidInput, match=r"got (?!an)"):
        tensors.encode(np.zeros(2, dtype))


def test_a_bool_is_zero_or_one() -> None:
    with pytest.raises(InvalidInput, match="0 and 1"):
        tensors.decode("BOOL", [2], b"\0\2", field="done")


def test_nothing_is_copied_and_nothing_can_be_written() -> None:
    raw = bytes(range(8))
    array = tensors.decode("UINT8", [8], raw)
    assert not array.flags.writeable
    assert np.shares_memory(array, np.frombuffer(raw, np.uint8))
