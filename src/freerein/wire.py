"""Frozen dataclasses to protobuf messages, to JSON, and back: one converter, by field name.

A dataclass of `freerein.types.x` and the message of the same name in `freerein.api.x.v1` have the same fields, so
nothing is written twice. By hand is only what has two natural forms: an array is a `Tensor` where the message says so,
and a list of numbers where it says `repeated`; an enum is a lower-case string; a `Struct` is a dict.

    dataclass --pack--> message         dataclass --to_json--> JSON values
    message or validated JSON --unpack--> dataclass
"""

import base64
import importlib
import math
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from functools import cache
from typing import Any, Literal, TypeVar, cast

import numpy as np
from google.protobuf import json_format, struct_pb2
from google.protobuf.descriptor import Descriptor, EnumDescriptor, FieldDescriptor
from google.protobuf.message import Message

from freerein import tensors
from freerein.api.common.v1 import common_pb2
from freerein.api.imitation.v1 import imitation_pb2
from freerein.api.learning.v1 import learning_pb2
from freerein.api.reward.v1 import reward_pb2
from freerein.api.segmentation.v1 import segmentation_pb2
from freerein.api.sim.v1 import sim_pb2
from freerein.errors import InvalidInput

T = TypeVar("T")

_MAX_DEPTH = 30  # of a `Struct`: protobuf itself reads 100 messages deep, which is 33 levels
_MESSAGES = {
    "freerein.types.common": common_pb2,
    "freerein.types.imitation": imitation_pb2,
    "freerein.types.learning": learning_pb2,
    "freerein.types.reward": reward_pb2,
    "freerein.types.segmentation": segmentation_pb2,
    "freerein.types.sim": sim_pb2,
}


def message_type(cls: type) -> type[Message]:
    """Returns the protobuf class of the same name as a dataclass of `freerein.types`."""
    return cast(type[Message], getattr(_MESSAGES[cls.__module__], cls.__name__))


def descriptor_of(cls: type) -> Descriptor:
    """Returns the descriptor of the message of the same name as a dataclass of `freerein.types`."""
    return cast(Descriptor, message_type(cls).DESCRIPTOR)


def dataclass_of(message: Descriptor) -> type[Any]:
    """Returns the dataclass of `freerein.types` of the same name as a message."""
    module = next(name for name, pb in _MESSAGES.items() if pb.DESCRIPTOR.name == message.file.name)
    return cast(type[Any], getattr(importlib.import_module(module), message.name))


def enum_name(enum: EnumDescriptor, number: int) -> str:
    """Returns an enum value's name on REST and in Python, such as `raw_rgb8`; empty for a number without one."""
    value = enum.values_by_number.get(number)
    return value.name.removeprefix(_enum_prefix(enum)).lower() if value else ""


def enum_names(enum: EnumDescriptor) -> tuple[str, ...]:
    """Returns the names of an enum's values but the first, which is UNSPECIFIED and always refused."""
    return tuple(enum_name(enum, value.number) for value in enum.values[1:])


def pack(value: Any) -> Message:
    """Returns a dataclass as a protobuf message."""
    message = message_type(type(value))()
    _fill(message, value)
    return message


def unpack(source: object, cls: type[T], *, path: str = "") -> T:
    """Returns a message, or a validated JSON model with the same attributes, as a dataclass.

    Args:
        source: What to read.
        cls: The dataclass wanted.
        path: Dotted name of `source` in the request, for errors.

    Raises:
        InvalidInput: An array, enum or number is not what it says, or a required one is missing.
    """
    values = {}
    for name, hint, descriptor, required in _layout(cls):
        dotted = f"{path}.{name}" if path else name
        value = _read(source, descriptor)
        if value is not None:
            values[name] = _value(value, hint, descriptor, dotted)
        elif required:
            raise InvalidInput(f"`{dotted}` is required; it is missing.", field=dotted, hint="Send it.")
    return cls(**values)


def to_json(value: Any) -> dict[str, Any]:
    """Returns a dataclass as JSON values: dicts, lists, strings, numbers; bytes as base64."""
    return {
        name: _json(getattr(value, name), descriptor)
        for name, _, descriptor, _ in _layout(type(value))
        if getattr(value, name) is not None
    }


def _make_layout(cls: Any) -> tuple[tuple[str, Any, FieldDescriptor, bool], ...]:
    """Returns (name, type, field of the message, required) of each field of a dataclass."""
    hints = typing.get_type_hints(cls)
    by_name = descriptor_of(cls).fields_by_name
    return tuple(
        (
            field.name,
            _without_none(hints[field.name]),
            by_name[field.name],
            field.default is MISSING and field.default_factory is MISSING and not _is_optional(hints[field.name]),
        )
        for field in fields(cls)
    )


_layout: Callable[[Any], tuple[tuple[str, Any, FieldDescriptor, bool], ...]] = cache(_make_layout)


def _is_optional(hint: Any) -> bool:
    return isinstance(hint, types.UnionType) and type(None) in typing.get_args(hint)


def _without_none(hint: Any) -> Any:
    return typing.get_args(hint)[0] if _is_optional(hint) else hint


# --- dataclass -> message


def _fill(message: Message, value: Any) -> None:
    """Sets a message in place, so that an array's bytes are copied once."""
    if isinstance(message, common_pb2.Tensor):
        message.datatype, shape, message.raw = tensors.encode(value)
        message.shape.extend(shape)
    elif isinstance(message, struct_pb2.Struct):
        json_format.ParseDict(value, message)
    else:
        message.SetInParent()
        for name, _, descriptor, _ in _layout(type(value)):
            if (item := getattr(value, name)) is not None:
                _assign(message, descriptor, item)


def _assign(message: Message, descriptor: FieldDescriptor, value: Any) -> None:
    target = getattr(message, descriptor.name)
    if (entry := _map_value(descriptor)) is not None:
        if entry.message_type is None:
            target.update(value)
        else:
            for key, item in value.items():
                _fill(target[key], item)
    elif descriptor.message_type is None:
        if descriptor.is_repeated:
            target.extend(value.tolist() if isinstance(value, np.ndarray) else value)
        else:
            setattr(message, descriptor.name, _enum_number(descriptor, value) if descriptor.enum_type else value)
    elif descriptor.is_repeated:
        for item in value:
            _fill(target.add(), item)
    else:
        _fill(target, value)


def _enum_number(descriptor: FieldDescriptor, name: str) -> int:
    enum = cast(EnumDescriptor, descriptor.enum_type)
    return enum.values_by_name[_enum_prefix(enum) + name.upper()].number


def _enum_prefix(enum: EnumDescriptor) -> str:
    return enum.values[0].name.removesuffix("UNSPECIFIED")


def _map_value(descriptor: FieldDescriptor) -> FieldDescriptor | None:
    """Returns the field of a map's values, None for a field that is no map."""
    entry = descriptor.message_type
    return entry.fields_by_name["value"] if entry is not None and entry.GetOptions().map_entry else None


# --- message or validated JSON -> dataclass


def _read(source: object, descriptor: FieldDescriptor) -> Any:
    """Returns a field's value, None where it is unset."""
    if isinstance(source, Message) and descriptor.has_presence and not source.HasField(descriptor.name):
        return None
    return getattr(source, descriptor.name)


def _value(value: Any, hint: Any, descriptor: FieldDescriptor, path: str) -> Any:
    origin = typing.get_origin(hint)
    if origin is tuple:
        return tuple(_one(item, typing.get_args(hint)[0], descriptor, f"{path}.{i}") for i, item in enumerate(value))
    if origin is dict and (entry := _map_value(descriptor)) is not None:
        item_hint = typing.get_args(hint)[1]
        return {key: _one(item, item_hint, entry, f"{path}.{key}") for key, item in value.items()}
    return _one(value, hint, descriptor, path)


def _one(value: Any, hint: Any, descriptor: FieldDescriptor, path: str) -> Any:
    for matches, convert in _CONVERTERS:
        if matches(hint):
            return convert(value, hint, descriptor, path)
    return unpack(value, hint, path=path) if descriptor.message_type is not None else value


def _array(value: Any, hint: Any, descriptor: FieldDescriptor, path: str) -> "np.ndarray[Any, Any]":
    if descriptor.message_type is None:
        return np.array(value, typing.get_args(typing.get_args(hint)[1])[0])
    return tensors.decode(value.datatype, tuple(value.shape), value.raw, field=path)


def _enum(value: Any, hint: Any, descriptor: FieldDescriptor, path: str) -> str:
    name = value if isinstance(value, str) else enum_name(cast(EnumDescriptor, descriptor.enum_type), value)
    if name not in typing.get_args(hint):
        raise InvalidInput(
            f"`{path}` must be one of {', '.join(typing.get_args(hint))}; got another value.",
            field=path,
            hint="It has no default: name the one you mean.",
        )
    return name


def _finite(value: Any, hint: Any, descriptor: FieldDescriptor, path: str) -> float:
    if not math.isfinite(value):
        raise _not_finite(path)
    return float(value)


def _not_finite(path: str) -> InvalidInput:
    return InvalidInput(
        f"`{path}` must be a finite number; got NaN or an infinity.", field=path, hint="Send a finite number."
    )


def _struct(value: Any, hint: Any, descriptor: FieldDescriptor, path: str) -> dict[str, Any]:
    if isinstance(value, struct_pb2.Struct):
        try:
            value = json_format.MessageToDict(value)
        except ValueError:  # its numbers may be NaN and infinite; JSON's may not
            raise _not_finite(path) from None
    return {key: _whole(item, path, 1) for key, item in cast(Mapping[str, Any], value).items()}


def _whole(value: Any, path: str, depth: int) -> Any:
    """Returns whole floats as ints, all through: a `Struct` knows only doubles."""
    if depth > _MAX_DEPTH:
        raise InvalidInput(
            f"`{path}` may be nested {_MAX_DEPTH} levels deep; it is deeper.", field=path, hint="Flatten it."
        )
    if isinstance(value, float):
        return int(value) if value.is_integer() else value
    if isinstance(value, list):
        return [_whole(item, path, depth + 1) for item in value]
    if isinstance(value, dict):
        return {key: _whole(item, path, depth + 1) for key, item in value.items()}
    return value


_CONVERTERS: tuple[tuple[Callable[[Any], bool], Callable[[Any, Any, FieldDescriptor, str], Any]], ...] = (
    (lambda hint: typing.get_origin(hint) is np.ndarray, _array),
    (lambda hint: typing.get_origin(hint) is Literal, _enum),
    (lambda hint: typing.get_origin(hint) is dict, _struct),
    (lambda hint: hint is float, _finite),
)


# --- dataclass -> JSON


def _json(value: Any, descriptor: FieldDescriptor) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist() if descriptor.message_type is None else _tensor_json(value)
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    if isinstance(value, tuple):
        return [_json(item, descriptor) for item in value]
    if isinstance(value, dict):
        entry = _map_value(descriptor)
        return {key: _json(item, entry) if entry else item for key, item in value.items()}
    return to_json(value) if descriptor.message_type is not None else value


def _tensor_json(array: "np.ndarray[Any, Any]") -> dict[str, Any]:
    datatype, shape, raw = tensors.encode(array)
    return {"datatype": datatype, "shape": list(shape), "raw": base64.b64encode(raw).decode("ascii")}
