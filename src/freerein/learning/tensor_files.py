"""Tensors as safetensors files, with limits on the header; reading never runs code."""

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
    """Returns the bytes of a safetensors file; equal tensors give equal bytes, whatever their memory layout."""
    return safetensors.torch.save({name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()})


def parse(data: bytes) -> dict[str, Tensor]:
    """Returns the tensors of a safetensors file, on the CPU; InvalidInput when it is malformed or over a limit."""
    _check_header(data)
    try:
        return safetensors.torch.load(data)
    except (safetensors.SafetensorError, KeyError, ValueError, RuntimeError) as error:
        raise InvalidInput("A safetensors file must be valid; its header does not fit its data.", hint=_MEND) from error


def _check_header(data: bytes) -> None:
    if len(data) < _LENGTH.size:
        raise InvalidInput(f"A safetensors file must have at least {_LENGTH.size} bytes; got {len(data)}.", hint=_MEND)
    (length,) = _LENGTH.unpack_from(data)
    available = min(MAX_HEADER_BYTES, len(data) - _LENGTH.size)
    if length > available:
        raise InvalidInput(
            f"A safetensors file must have a header of at most {available} bytes; got {length}.",
            hint=_MEND,
        )
    try:
        header = json.loads(data[_LENGTH.size : _LENGTH.size + length])
    except (ValueError, RecursionError) as error:
        raise InvalidInput("A safetensors file must be valid; its header is not JSON.", hint=_MEND) from error
    if not isinstance(header, dict) or len(header) > MAX_ENTRIES:
        entries = str(len(header)) if isinstance(header, dict) else "something else"
        raise InvalidInput(
            f"The header of a safetensors file must hold at most {MAX_ENTRIES} entries; got {entries}.", hint=_MEND
        )
