"""Conversion between frozen dataclasses, protobuf messages and JSON, by field name.

A dataclass of `freerein.types.x` and the message of the same name in `freerein.api.x.v1` have the same fields. An
array is a `Tensor` or a repeated number, an enum a lower-case string, a `Struct` a dict.

    dataclass --pack--> message         dataclass --to_json--> JSON values
    message or validated JSON --unpack--> dataclass
"""

import base64
import importlib
import math
import typing
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from functools import cache, partial
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from google.protobuf import json_format, struct_pb2
from google.protobuf.descriptor import Descriptor, EnumDescriptor, FieldDescriptor, ServiceDescriptor
from google.protobuf.message import Message

from freerein import tensors
from freerein.api.common.v1 import common_pb2
from freerein.api.imitation.v1 import imitation_pb2
from freerein.api.jobs.v1 import jobs_pb2
from freerein.api.learning.v1 import learning_pb2
from freerein.api.orchestrator.v1 import orchestrator_pb2
from freerein.api.reward.v1 import reward_pb2
from freerein.api.segmentation.v1 import segmentation_pb2
from freerein.api.sim.v1 import sim_pb2
from freerein.errors import InvalidInput, must_be
from freerein.field_bounds import bounds_of, check_bounds, check_json_bytes

T = TypeVar("T")

_MAX_DEPTH = 30  # levels of a `Struct`: protobuf parses 100 messages deep, which is 33 levels
_BASE64_BYTES = 3 * 2**20  # at once: the interpreter runs no other thread meanwhile
_EXACT = 2.0**53  # integers below it are exact as doubles
# dtypes of arrays that are repeated numbers in the message
_ARRAY_DTYPES = {
    FieldDescriptor.TYPE_FLOAT: np.float32,
    FieldDescriptor.TYPE_INT32: np.int64,
    FieldDescriptor.TYPE_UINT32: np.int64,
}
_MESSAGES = {
    "freerein.types.common": common_pb2,
    "freerein.types.imitation": imitation_pb2,
    "freerein.types.jobs": jobs_pb2,
    "freerein.types.learning": learning_pb2,
    "freerein.types.orchestrator": orchestrator_pb2,
    "freerein.types.reward": reward_pb2,
    "freerein.types.segmentation": segmentation_pb2,
    "freerein.types.sim": sim_pb2,
}


def services() -> tuple[ServiceDescriptor, ...]:
    """Returns the services of all `.proto` files."""
    return tuple(each for module in _MESSAGES.values() for each in module.DESCRIPTOR.services_by_name.values())


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
    """Returns an enum value's name on REST and in Python, such as `raw_rgb8`; empty for an unknown number."""
    value = enum.values_by_number.get(number)
    return value.name.removeprefix(_enum_prefix(enum)).lower() if value else ""


def enum_names(enum: EnumDescriptor) -> tuple[str, ...]:
    """Returns the names of an enum's values except UNSPECIFIED, which is always refused."""
    return tuple(enum_name(enum, value.number) for value in enum.values[1:])


def pack(value: Any) -> Message:
    """Returns a dataclass as a protobuf message."""
    return message_type(type(value))(**_values(value))


def unpack(source: object, cls: type[T], *, path: str = "") -> T:
    """Converts a message, or a validated JSON model with the same attributes, into a dataclass.

    Args:
        source: The message or model.
        cls: The dataclass.
        path: Dotted name of `source` in the request, for errors.

    Raises:
        InvalidInput: An array, enum or number is invalid, or a required field is missing.
    """
    values: dict[str, Any] = {}
    is_set = source.HasField if isinstance(source, Message) else None
    for name, _, has_presence, required, read, _ in _layout(cls):
        value = getattr(source, name) if is_set is None or not has_presence or is_set(name) else None
        if value is not None:
            values[name] = value if read is None else read(value, f"{path}.{name}" if path else name)
        elif required:
            dotted = f"{path}.{name}" if path else name
            raise InvalidInput(f"`{dotted}` is required; it is missing.", field=dotted, hint="Send it.")
    return cls(**values)


def base64_text(raw: Any) -> str:
    """Returns bytes, `bytes` or uint8 (N), as base64."""
    parts = (raw[at : at + _BASE64_BYTES] for at in range(0, len(raw), _BASE64_BYTES))
    return "".join([base64.b64encode(part).decode("ascii") for part in parts])


def tensor_json(array: "np.ndarray[Any, Any]", *, write_bytes: Callable[[Any], str] = base64_text) -> dict[str, Any]:
    """Returns an array as the JSON values of a `Tensor`."""
    datatype, shape, raw = tensors.encode_in_place(array)
    return {"datatype": datatype, "shape": list(shape), "raw": write_bytes(raw)}


def to_json(
    value: Any,
    *,
    write_tensor: Callable[["np.ndarray[Any, Any]"], Any] | None = None,
    write_bytes: Callable[[Any], str] = base64_text,
) -> dict[str, Any]:
    """Returns a dataclass as JSON values: dicts, lists, strings, numbers.

    Args:
        value: The dataclass.
        write_tensor: Returns an array as JSON values; None for the fields of a `Tensor`.
        write_bytes: Returns bytes, and an array's as uint8 (N), as text: by default as base64.
    """
    tensor = write_tensor or partial(tensor_json, write_bytes=write_bytes)
    return {
        field.name: _json(getattr(value, field.name), field.descriptor, tensor, write_bytes)
        for field in _layout(type(value))
        if getattr(value, field.name) is not None
    }


# --- how each field is converted, computed once per dataclass

_Read = Callable[[Any, str], Any]
_Write = Callable[[Any], Any]


class _Field(NamedTuple):
    """A field of a dataclass, and of the message of the same name; `read` and `write` are None for the identity.

    Attributes:
        has_presence: Whether the message distinguishes unset from zero.
        required: Whether the dataclass has no default for it.
        read: Converts the message's value and a dotted name, for errors, into the dataclass's.
        write: Converts the dataclass's value into the message's.
    """

    name: str
    descriptor: FieldDescriptor
    has_presence: bool
    required: bool
    read: _Read | None
    write: _Write | None


def _make_layout(cls: Any) -> tuple[_Field, ...]:
    by_name, hints = descriptor_of(cls).fields_by_name, typing.get_type_hints(cls)
    layout = []
    for field in fields(cls):
        descriptor, hint = by_name[field.name], hints[field.name]
        has_default = field.default is not MISSING or field.default_factory is not MISSING
        layout.append(
            _Field(
                name=field.name,
                descriptor=descriptor,
                has_presence=descriptor.has_presence,
                required=not has_default and type(None) not in typing.get_args(hint),
                read=_bounded(descriptor, _reader(descriptor, is_tuple=typing.get_origin(hint) is tuple)),
                write=_writer(descriptor),
            )
        )
    return tuple(layout)


_layout: Callable[[Any], tuple[_Field, ...]] = cache(_make_layout)  # typed: a class is hashable


def _map_value(descriptor: FieldDescriptor) -> FieldDescriptor | None:
    """Returns the field of a map's values; None when the field is not a map."""
    entry = descriptor.message_type
    return entry.fields_by_name["value"] if entry is not None and entry.GetOptions().map_entry else None


def _enum_prefix(enum: EnumDescriptor) -> str:
    return enum.values[0].name.removesuffix("UNSPECIFIED")


# --- dataclass -> message


def _values(value: Any) -> dict[str, Any]:
    """Returns the constructor arguments of a message; nested messages are dicts."""
    values: dict[str, Any] = {}
    for name, _, _, _, _, write in _layout(type(value)):
        if (item := getattr(value, name)) is not None:
            values[name] = item if write is None else write(item)
    return values


def _writer(descriptor: FieldDescriptor) -> _Write | None:
    if (entry := _map_value(descriptor)) is not None:
        one = _one_writer(entry)
        return None if one is None else lambda values: {key: one(value) for key, value in values.items()}
    if not descriptor.is_repeated:
        return _one_writer(descriptor)
    if descriptor.message_type is None:
        return lambda values: values.tolist() if isinstance(values, np.ndarray) else values
    each = _one_writer(descriptor)
    return None if each is None else lambda values: [each(value) for value in values]


def _one_writer(descriptor: FieldDescriptor) -> _Write | None:
    message, enum = descriptor.message_type, descriptor.enum_type
    if enum is not None:
        return {enum_name(enum, value.number): value.number for value in enum.values}.__getitem__
    if message is None or message == struct_pb2.Struct.DESCRIPTOR:
        return None
    return _tensor_values if message == common_pb2.Tensor.DESCRIPTOR else _values


def _tensor_values(array: "np.ndarray[Any, Any]") -> dict[str, Any]:
    datatype, shape, raw = tensors.encode(array)
    return {"datatype": datatype, "shape": shape, "raw": raw}


# --- message or validated JSON -> dataclass


def _bounded(descriptor: FieldDescriptor, read: _Read | None) -> _Read | None:
    """Returns a reader that checks the bounds of a field, too."""
    bounds = bounds_of(descriptor)
    if not any(bounds):
        return read
    is_struct = descriptor.message_type == struct_pb2.Struct.DESCRIPTOR

    def checked(value: Any, path: str) -> Any:
        if not is_struct:
            check_bounds(value, bounds, path)
        result = value if read is None else read(value, path)
        if is_struct:
            check_json_bytes(result, bounds, path)
        return result

    return checked


def _reader(descriptor: FieldDescriptor, *, is_tuple: bool) -> _Read | None:
    """Returns the reader of a field. It depends on the message, never on the runtime form of `numpy.typing.NDArray`."""
    if (entry := _map_value(descriptor)) is not None:
        each = _one_reader(entry)
        if each is None:
            return lambda values, _path: dict(values)
        return lambda values, path: {key: each(value, path) for key, value in values.items()}
    if not descriptor.is_repeated:
        return _one_reader(descriptor)
    if not is_tuple:
        dtype = _ARRAY_DTYPES[descriptor.type]
        return lambda values, _path: np.array(values, dtype)
    one = _one_reader(descriptor)
    if one is None:
        return lambda values, _path: tuple(values)
    return lambda values, path: tuple(one(value, f"{path}.{i}") for i, value in enumerate(values))


def _one_reader(descriptor: FieldDescriptor) -> _Read | None:
    message = descriptor.message_type
    if descriptor.enum_type is not None:
        return _enum_reader(descriptor.enum_type)
    if descriptor.type in (FieldDescriptor.TYPE_FLOAT, FieldDescriptor.TYPE_DOUBLE):
        return _finite
    if message is None:
        return None
    if message == common_pb2.Tensor.DESCRIPTOR:
        return _tensor
    if message == struct_pb2.Struct.DESCRIPTOR:
        return _struct
    cls = dataclass_of(message)
    return lambda value, path: unpack(value, cls, path=path)


def _tensor(value: Any, path: str) -> "np.ndarray[Any, Any]":
    return tensors.decode(value.datatype, tuple(value.shape), value.raw, field=path)


def _enum_reader(enum: EnumDescriptor) -> _Read:
    names = enum_names(enum)

    def read(value: Any, path: str) -> str:
        name = value if isinstance(value, str) else enum_name(enum, value)
        if name not in names:
            hint = "It has no default: send one of them."
            raise must_be(path, f"one of {', '.join(names)}", "another value", hint=hint)
        return name

    return read


def _finite(value: Any, path: str) -> float:
    if not math.isfinite(value):
        raise _not_finite(path)
    return float(value)


def _not_finite(path: str) -> InvalidInput:
    return must_be(path, "a finite number", "NaN or an infinity", hint="Send a finite number.")


def _struct(value: Any, path: str) -> dict[str, Any]:
    if isinstance(value, struct_pb2.Struct):
        try:
            value = json_format.MessageToDict(value)
        except ValueError:  # a Struct may hold NaN and infinities, JSON may not
            raise _not_finite(path) from None
    return {key: _with_ints(item, path, 1) for key, item in cast(Mapping[str, Any], value).items()}


def _with_ints(value: Any, path: str, depth: int) -> Any:
    """Returns a value of a `Struct` with whole numbers as ints; a `Struct` itself has only doubles."""
    if depth > _MAX_DEPTH:
        raise InvalidInput(
            f"`{path}` may be nested at most {_MAX_DEPTH} levels deep; it is deeper.", field=path, hint="Flatten it."
        )
    if isinstance(value, int | float) and not isinstance(value, bool):
        return _number(value, path)
    if isinstance(value, list):
        return [_with_ints(item, path, depth + 1) for item in value]
    if isinstance(value, dict):
        return {key: _with_ints(item, path, depth + 1) for key, item in value.items()}
    return value


def _number(value: float, path: str) -> float:
    try:
        double = _finite(value, path)
    except OverflowError:  # an int beyond the range of doubles
        raise _not_finite(path) from None
    return int(double) if double.is_integer() and abs(double) < _EXACT else double


# --- dataclass -> JSON


def _json(value: Any, descriptor: FieldDescriptor, write_tensor: _Write, write_bytes: _Write) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist() if descriptor.message_type is None else write_tensor(value)
    if isinstance(value, bytes):
        return write_bytes(value)
    if isinstance(value, tuple):
        return [_json(item, descriptor, write_tensor, write_bytes) for item in value]
    if isinstance(value, dict):
        entry = _map_value(descriptor)
        return {key: _json(item, entry, write_tensor, write_bytes) if entry else item for key, item in value.items()}
    if descriptor.message_type is None:
        return value
    return to_json(value, write_tensor=write_tensor, write_bytes=write_bytes)
