"""openpi's messages: maps in msgpack, whose arrays are maps of dtype, shape and bytes (its `msgpack_numpy`).

They are read strictly, as anyone may have sent them: only dtypes that tensors have, no extension types, no key twice.
Their values are counted before they are built: one of one byte takes up to a hundred in memory.
"""

import asyncio
from collections.abc import Iterable, Mapping
from typing import Any

import msgpack
import numpy as np
import numpy.typing as npt

from freerein import tensors
from freerein.errors import InvalidInput, MalformedRequest, must_be
from freerein.serving.limits import FEW_VALUES, MAX_INLINE_BYTES, MAX_INLINE_IMAGE_BYTES, MAX_VALUES

_ARRAY, _SCALAR = b"__ndarray__", b"__npgeneric__"
_ARRAY_KEYS = {_ARRAY, b"data", b"dtype", b"shape"}
_SCALAR_KEYS = {_SCALAR, b"data", b"dtype"}
_PACKAGE_ARRAY_KEYS = {b"nd", b"type", b"kind", b"shape", b"data"}  # of the package msgpack-numpy
_PACKAGE_SCALAR_KEYS = {b"nd", b"type", b"data"}
_DATATYPES = {dtype.str: name for name, dtype in tensors.DTYPES.items()}
_HINT = "Send what openpi_client.msgpack_numpy packs."

# By a value's first byte: the bytes that follow it, or else how many bytes hold its length or its number of items.
_SIZES = dict.fromkeys((*range(0x80), *range(0xE0, 0x100), 0xC0, 0xC2, 0xC3), 0)
_SIZES |= {0xA0 + size: size for size in range(32)}
_SIZES |= {0xCA: 4, 0xCB: 8, 0xCC: 1, 0xCD: 2, 0xCE: 4, 0xCF: 8, 0xD0: 1, 0xD1: 2, 0xD2: 4, 0xD3: 8}
_SIZES |= {0xD4: 2, 0xD5: 3, 0xD6: 5, 0xD7: 9, 0xD8: 17}  # extensions, with their type
_LENGTHS = {0xC4: 1, 0xC5: 2, 0xC6: 4, 0xD9: 1, 0xDA: 2, 0xDB: 4}
_EXTENSION_LENGTHS = {0xC7: 1, 0xC8: 2, 0xC9: 4}
_COUNTS = {0xDC: (2, 1), 0xDD: (4, 1), 0xDE: (2, 2), 0xDF: (4, 2)}  # and the values of an item


def pack(message: Mapping[str, Any]) -> bytes:
    """Returns a map of arrays, texts, numbers and lists as a message."""
    data: bytes = msgpack.packb(message, default=_pack_array)
    return data


async def read(data: bytes) -> dict[str, Any]:
    """Returns the map in a message, as `unpack`; on a thread where that would hold up the event loop."""
    is_quick = len(data) <= MAX_INLINE_BYTES or (
        len(data) <= MAX_INLINE_IMAGE_BYTES and not _has_more_values(data, FEW_VALUES)
    )
    return unpack(data) if is_quick else await asyncio.to_thread(unpack, data)


def unpack(data: bytes) -> dict[str, Any]:
    """Returns the map in a message; its arrays are read-only.

    Raises:
        MalformedRequest: It is not msgpack, has an extension type, a key twice, or too many values.
        InvalidInput: It is not a map of names, or an array's dtype, shape or bytes are invalid.
    """
    if _has_more_values(data, MAX_VALUES):
        raise MalformedRequest(f"A message may hold at most {MAX_VALUES} values; got more.", hint="Send arrays.")
    try:
        message = msgpack.unpackb(data, object_pairs_hook=_map, ext_hook=_refuse_extension, timestamp=0)
    except ValueError:  # every error of the parser is one
        raise MalformedRequest(
            "A message must be one whole msgpack value; it could not be parsed.", hint=_HINT
        ) from None
    if not isinstance(message, dict):
        raise InvalidInput(f"A message must be a map; got {type(message).__name__}.", hint=_HINT)
    if others := {type(key).__name__ for key in message if not isinstance(key, str)}:
        raise InvalidInput(f"The keys of a message must be texts; got {', '.join(sorted(others))}.", hint=_HINT)
    return message


def _has_more_values(data: bytes, most: int) -> bool:
    """Returns whether a message has, or announces, more values: containers, what they hold, and keys.

    What cannot be read ends the count: the parser refuses it.
    """
    position, seen, due = 0, 0, 1
    while due and position < len(data):
        byte = data[position]
        position += 1
        seen, due = seen + 1, due - 1
        if (size := _SIZES.get(byte)) is not None:
            position += size
        elif 0x80 <= byte < 0xA0:
            due += (byte & 0x0F) * (2 if byte < 0x90 else 1)
        elif byte in _COUNTS:
            width, values = _COUNTS[byte]
            due += values * int.from_bytes(data[position : position + width])
            position += width
        elif byte in _LENGTHS:
            width = _LENGTHS[byte]
            position += width + int.from_bytes(data[position : position + width])
        elif byte in _EXTENSION_LENGTHS:
            width = _EXTENSION_LENGTHS[byte]
            position += width + 1 + int.from_bytes(data[position : position + width])
        else:
            return False
        if seen + due > most:
            return True
    return False


def _map(pairs: Iterable[tuple[Any, Any]]) -> Any:
    pairs = list(pairs)
    found = dict(pairs)
    if len(found) != len(pairs):
        raise MalformedRequest("A map's keys must be unique; one is repeated.", hint="Send each key once.")
    if found.keys() == _ARRAY_KEYS:
        return _unpack_array(found)
    if found.keys() == _SCALAR_KEYS:
        return _unpack_scalar(found)
    if found.keys() == _PACKAGE_ARRAY_KEYS and found[b"nd"] is True:
        return _unpack_array({**found, b"dtype": found[b"type"]})
    if found.keys() == _PACKAGE_SCALAR_KEYS and found[b"nd"] is False:
        return _unpack_array({**found, b"dtype": found[b"type"], b"shape": []}).item()
    return found


def _pack_array(value: object) -> object:
    if not isinstance(value, np.ndarray):
        raise TypeError(f"messages hold no {type(value).__name__}")
    return {_ARRAY: True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}


def _unpack_array(parts: Mapping[bytes, Any]) -> npt.NDArray[Any]:
    data, shape = parts[b"data"], parts[b"shape"]
    are_lengths = isinstance(shape, list) and all(type(length) is int for length in shape)
    if not isinstance(data, bytes) or not are_lengths:
        raise InvalidInput(
            f"An array must have bytes as data and a list of lengths as shape; got {type(data).__name__} and "
            f"{'a list with others' if isinstance(shape, list) else type(shape).__name__}.",
            hint=_HINT,
        )
    return tensors.decode(_datatype(parts[b"dtype"]), shape, data, field="array")


def _unpack_scalar(parts: Mapping[bytes, Any]) -> bool | int | float:
    value = parts[b"data"]
    _datatype(parts[b"dtype"])
    if not isinstance(value, bool | int | float):
        raise InvalidInput(
            f"A numpy scalar's data must be a number or a boolean; got a value of type {type(value).__name__}.",
            hint=_HINT,
        )
    return value


def _datatype(dtype: object) -> str:
    name = _DATATYPES.get(dtype) if isinstance(dtype, str) else None
    if name is None:
        rule = f"one of {', '.join(map(str, tensors.DTYPES.values()))}, little-endian"
        hint = "Convert it with array.astype(...) first."
        raise must_be("An array's dtype", rule, "another", field="", hint=hint)
    return name


def _refuse_extension(_code: int, _data: bytes) -> object:
    raise MalformedRequest("A message may hold no msgpack extension types; it holds one.", hint=_HINT)
