"""Decodes gRPC messages: their values are counted before they are parsed, and large messages leave the event loop.

A parsed value of two bytes takes about a hundred in memory, so bytes alone do not bound the cost of a message.
"""

import asyncio
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import numpy as np
from google.protobuf.descriptor import Descriptor
from google.protobuf.message import DecodeError, Message

from freerein import wire
from freerein.errors import InvalidInput, MalformedRequest, ServiceError
from freerein.serving.limits import FEW_VALUES, MAX_INLINE_BYTES, MAX_INLINE_IMAGE_BYTES, MAX_VALUES
from freerein.serving.methods import InvalidMessage

T = TypeVar("T")

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_LAST_BYTE = 0x80  # the last byte of a varint is below it


async def decode(message: bytes, cls: type[T]) -> T:
    """Returns the dataclass of a message.

    Raises:
        InvalidInput: It holds more than `MAX_VALUES` values, or as `wire.unpack`.
        MalformedRequest: It cannot be parsed.
    """
    return await _run(message, cls, lambda: wire.unpack(_parse(message, cls), cls))


async def decode_part(message: bytes, cls: type[T]) -> T | InvalidMessage:
    """Returns the dataclass of one message of a stream, an `InvalidMessage` where `decode` would raise."""

    def work() -> T | InvalidMessage:
        parsed: Message | None = None
        try:
            parsed = _parse(message, cls)
            return wire.unpack(parsed, cls)
        except ServiceError as error:
            return InvalidMessage(error, _seq(parsed))

    return await _run(message, cls, work)


async def _run(message: bytes, cls: type[Any], work: Callable[[], T]) -> T:
    """Runs what decodes a message; on a thread where it would hold up the event loop."""
    return work() if _is_quick(message, cls) else await asyncio.to_thread(work)


def _is_quick(message: bytes, cls: type[Any]) -> bool:
    if not MAX_INLINE_BYTES < len(message) <= MAX_INLINE_IMAGE_BYTES:
        return len(message) <= MAX_INLINE_BYTES
    try:
        return not _has_more_values(message, wire.descriptor_of(cls), FEW_VALUES)
    except (DecodeError, IndexError):  # will be refused at once
        return True


def _seq(message: Message | None) -> int | None:
    """Returns the `seq` of the part of a message that has one."""
    for field, value in message.ListFields() if message is not None else ():
        if field.message_type is not None and "seq" in field.message_type.fields_by_name:
            return int(value.seq)
    return None


def _parse(message: bytes, cls: type[Any]) -> Message:
    try:
        # a value takes at least one byte
        if len(message) > MAX_VALUES and _has_more_values(message, wire.descriptor_of(cls), MAX_VALUES):
            raise InvalidInput(
                f"A message may hold at most {MAX_VALUES} values; got more.",
                hint="Send arrays as tensors, and less per call.",
            )
        return wire.message_type(cls).FromString(message)
    except (DecodeError, IndexError):
        raise MalformedRequest(
            f"The bytes must be a {cls.__name__} message; they could not be read as one.",
            hint="Generate the client from the .proto files, or ask the reflection service.",
        ) from None


def _has_more_values(data: bytes, descriptor: Descriptor, most: int) -> bool:
    """Returns whether a message has more fields, counting those of its messages and each packed number.

    Raises IndexError where the bytes end too soon, DecodeError for a part that is longer than the whole, or a wire type
    that no message has.
    """
    values, parts = 0, [(0, len(data), _nested(descriptor))]
    while parts:
        position, end, nested = parts.pop()
        while position < end:
            key, position = _varint(data, position)
            values += 1
            if key & 7 == _BYTES:
                length, position = _varint(data, position)
                number = key >> 3
                if position + length > end:  # else bytes could be counted many times
                    raise DecodeError
                if number in nested:
                    if (inner := nested[number]) is None:
                        packed = np.frombuffer(data, np.uint8, length, position)
                        values += int(np.count_nonzero(packed < _LAST_BYTE))
                    else:
                        parts.append((position, position + length, _nested(inner)))
                position += length
            elif key & 7 == _VARINT:
                _, position = _varint(data, position)
            elif key & 7 in (_FIXED64, _FIXED32):
                position += 8 if key & 7 == _FIXED64 else 4
            else:
                raise DecodeError
            if values > most:
                return True
    return False


@cache
def _nested(message: Descriptor) -> dict[int, Descriptor | None]:
    """Returns, by number, the messages of those fields that hold messages, and None for those that hold numbers."""
    packed = (field for field in message.fields if field.is_packed)
    inner = (field for field in message.fields if field.message_type is not None)
    return {field.number: None for field in packed} | {field.number: field.message_type for field in inner}


def _varint(data: bytes, position: int) -> tuple[int, int]:
    """Returns a number, and the position after it."""
    value = shift = 0
    while (byte := data[position]) >= _LAST_BYTE:
        value |= (byte - _LAST_BYTE) << shift
        shift += 7
        position += 1
        if shift > 63:
            raise DecodeError
    return value | byte << shift, position + 1
