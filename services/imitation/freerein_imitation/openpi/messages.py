"""openpi's messages: maps in msgpack, whose arrays are maps of dtype, shape and bytes (its `msgpack_numpy`).

They are read strictly, as anyone may have sent them: only dtypes that tensors have, no extension types, no key twice.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import msgpack
import numpy as np
import numpy.typing as npt

from freerein import tensors
from freerein.errors import InvalidInput, MalformedRequest
from freerein.serving.limits import MAX_VALUES

_ARRAY, _SCALAR = b"__ndarray__", b"__npgeneric__"
_ARRAY_KEYS = {_ARRAY, b"data", b"dtype", b"shape"}
_SCALAR_KEYS = {_SCALAR, b"data", b"dtype"}
_DATATYPES = {dtype.str: name for name, dtype in tensors.DTYPES.items()}
_HINT = "Send what openpi_client.msgpack_numpy packs."


def pack(message: Mapping[str, Any]) -> bytes:
    """Returns a map of arrays, texts, numbers and lists as a message."""
    data: bytes = msgpack.packb(message, default=_pack_array)
    return data


def unpack(data: bytes) -> dict[str, Any]:
    """Returns the map in a message; its arrays are read-only.

    Raises:
        MalformedRequest: It is not msgpack, has an extension type, a key twice, or too many values.
        InvalidInput: It is not a map of names, or an array's dtype, shape or bytes are invalid.
    """
    reader = _Reader()
    try:
        message = msgpack.unpackb(
            data, object_pairs_hook=reader.map, list_hook=reader.list, ext_hook=_refuse_extension, timestamp=0
        )
    except ValueError:  # every error of the parser is one
        raise MalformedRequest(
            "A message must be one whole msgpack value; it could not be parsed.", hint=_HINT
        ) from None
    if not isinstance(message, dict) or not all(isinstance(key, str) for key in message):
        raise InvalidInput("A message must be a map whose keys are texts; it is not.", hint=_HINT)
    return message


class _Reader:
    """Builds the values of one message, and bounds their number: a value of one byte takes tens of them in memory."""

    def __init__(self) -> None:
        self._values = 0

    def list(self, items: list[Any]) -> list[Any]:
        self._count(len(items))
        return items

    def map(self, pairs: Iterable[tuple[Any, Any]]) -> Any:
        pairs = list(pairs)
        self._count(2 * len(pairs))
        found = dict(pairs)
        if len(found) != len(pairs):
            raise MalformedRequest("A map's keys must be unique; one is repeated.", hint="Send each key once.")
        if found.keys() == _ARRAY_KEYS:
            return _unpack_array(found)
        if found.keys() == _SCALAR_KEYS:
            return _unpack_scalar(found)
        return found

    def _count(self, values: int) -> None:
        self._values += values
        if self._values > MAX_VALUES:
            raise MalformedRequest(f"A message may hold at most {MAX_VALUES} values; got more.", hint="Send arrays.")


def _pack_array(value: object) -> object:
    if not isinstance(value, np.ndarray):
        raise TypeError(f"messages hold no {type(value).__name__}")
    return {_ARRAY: True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}


def _unpack_array(parts: Mapping[bytes, Any]) -> npt.NDArray[Any]:
    data, shape = parts[b"data"], parts[b"shape"]
    are_lengths = isinstance(shape, list) and all(type(length) is int for length in shape)
    if not isinstance(data, bytes) or not are_lengths:
        raise InvalidInput("An array must have bytes as data and a list of lengths as shape; it has not.", hint=_HINT)
    return tensors.decode(_datatype(parts[b"dtype"]), shape, data, field="array")


def _unpack_scalar(parts: Mapping[bytes, Any]) -> bool | int | float:
    value = parts[b"data"]
    _datatype(parts[b"dtype"])
    if not isinstance(value, bool | int | float):
        raise InvalidInput("A numpy scalar's data must be a number or a boolean; it is not.", hint=_HINT)
    return value


def _datatype(dtype: object) -> str:
    name = _DATATYPES.get(dtype) if isinstance(dtype, str) else None
    if name is None:
        raise InvalidInput(
            f"An array's dtype must be one of {', '.join(map(str, tensors.DTYPES.values()))}, little-endian; "
            "got another.",
            hint="Convert it with array.astype(...) first.",
        )
    return name


def _refuse_extension(_code: int, _data: bytes) -> object:
    raise MalformedRequest("A message may hold no msgpack extension types; it holds one.", hint=_HINT)
