"""Tensors on disk: safetensors, with caps of our own, and never anything that runs code when it is read."""

import json
import struct
from collections.abc import Mapping

import safetensors
import safetensors.torch
from torch import Tensor

from freerein.errors import InvalidInput

MAX_HEADER_BYTES = 1 << 20
MAX_ENTRIES = 10_000
_LENGTH = struct.Struct("<Q")
_MEND = "Restore the file from a copy; convert weights of another format with safetensors.torch.save_file."


def dump(tensors: Mapping[str, Tensor]) -> bytes:
    """Returns the bytes of a safetensors file; the same tensors give the same bytes, wherever they lie in memory."""
    return safetensors.torch.save({name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()})


def parse(data: bytes) -> dict[str, Tensor]:
    """Returns the tensors that the bytes of a safetensors file hold, on the CPU.

    Raises:
        InvalidInput: They are not safetensors, or the header is over a cap.
    """
    _check_header(data)
    try:
        return safetensors.torch.load(data)
    except (safetensors.SafetensorError, KeyError, ValueError, RuntimeError) as error:
        raise InvalidInput(
            "A file of tensors must be safetensors; its header does not fit its data.", hint=_MEND
        ) from error


def _check_header(data: bytes) -> None:
    if len(data) < _LENGTH.size:
        raise InvalidInput(f"A file of tensors must have at least {_LENGTH.size} bytes; got {len(data)}.", hint=_MEND)
    (length,) = _LENGTH.unpack_from(data)
    available = min(MAX_HEADER_BYTES, len(data) - _LENGTH.size)
    if length > available:
        raise InvalidInput(
            f"A file of tensors must be safetensors with a header of at most {available} bytes; it claims {length}.",
            hint=_MEND,
        )
    try:
        header = json.loads(data[_LENGTH.size : _LENGTH.size + length])
    except (ValueError, RecursionError) as error:
        raise InvalidInput("A file of tensors must be safetensors; its header is not JSON.", hint=_MEND) from error
    if not isinstance(header, dict) or len(header) > MAX_ENTRIES:
        entries = f"{len(header)} of them" if isinstance(header, dict) else "something else"
        raise InvalidInput(
            f"The header of a file of tensors must hold at most {MAX_ENTRIES} entries; got {entries}.", hint=_MEND
        )
