"""Pydantic models of protobuf messages, for REST: the same field names, no unknown fields, finite numbers only.

They check the types of a request; the core checks its values, for REST and gRPC alike.
"""

import binascii
from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any, Literal

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from pybase64 import b64decode
from pydantic import BaseModel, BeforeValidator, ConfigDict, FailFast, Field, JsonValue, WithJsonSchema, create_model

from freerein import tensors, wire
from freerein.api.common.v1 import common_pb2
from freerein.field_bounds import bounds_of, datatypes_of
from freerein.serving.rest.comments import comment_of
from freerein.serving.rest.tensor_lists import OrList

STRUCT = "google.protobuf.Struct"
_DATATYPES = ("FP32", "INT64")
"""Datatypes of a tensor whose field names none: one of a reply."""

_INTEGERS = {
    FieldDescriptor.TYPE_UINT32: (0, 2**32 - 1),
    FieldDescriptor.TYPE_UINT64: (0, 2**64 - 1),
    FieldDescriptor.TYPE_INT32: (-(2**31), 2**31 - 1),
    FieldDescriptor.TYPE_INT64: (-(2**63), 2**63 - 1),
}


class Schema(BaseModel):
    """Base of all models. Attributes have the names of the message's fields."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


_NOT_BASE64 = "must be base64 with padding and without spaces"


def _bytes(value: object) -> object:
    """Decodes strict base64; a multipart file is bytes already."""
    if not isinstance(value, str):
        return value
    try:
        return b64decode(value, validate=True)  # 50 times as fast as Python's, and strict about padding
    except (binascii.Error, ValueError):
        raise ValueError(_NOT_BASE64) from None


Base64 = Annotated[bytes, BeforeValidator(_bytes), WithJsonSchema({"type": "string", "format": "byte"})]


@cache
def schema_of(message: Descriptor) -> type[Schema]:
    """Returns the pydantic model of a message."""
    if message is common_pb2.Tensor.DESCRIPTOR:
        types = _tensor_fields()
    else:
        types = {field.name: _field(field) for field in message.fields}
    fields = {name: _described(message.fields_by_name[name], *each) for name, each in types.items()}
    return create_model(message.name, __base__=Schema, __doc__=comment_of(message.full_name), **fields)


def _tensor_fields() -> dict[str, Any]:
    names = tuple(tensors.DTYPES)
    return {
        "datatype": (Literal[names], ...),
        "shape": (Annotated[list[Annotated[int, Field(ge=0, le=2**63 - 1)]], FailFast()], ...),
        "raw": (Base64, ...),
    }


def _described(field: FieldDescriptor, kind: Any, default: Any) -> Any:
    """Returns (type, default) with the comment of the field, and of each value of an enum."""
    sentences = [comment_of(field.full_name)]
    if field.enum_type is not None:
        values = zip(wire.enum_names(field.enum_type), field.enum_type.values[1:], strict=True)
        sentences += [f"`{name}`: {comment_of(f'{field.enum_type.full_name}.{value.name}')}" for name, value in values]
    return Annotated[kind, Field(description=" ".join(sentences))], default


def _field(field: FieldDescriptor) -> Any:
    """Returns (type, default) as in protobuf: unset numbers are 0, unset messages None; enums are required."""
    message = field.message_type
    max_items, max_length = bounds_of(field)
    if message is not None and message.GetOptions().map_entry:
        value = _type(message.fields_by_name["value"], datatypes_of(field))
        return Annotated[dict[_text(max_length), value], _shown(maxProperties=max_items)], {}  # type: ignore[misc]  # made at run time
    if field.is_repeated:
        each = _text(max_length) if field.type == FieldDescriptor.TYPE_STRING else _type(field)
        return Annotated[list[each], FailFast(), _shown(maxItems=max_items)], []  # type: ignore[valid-type]  # made at run time
    if field.type == FieldDescriptor.TYPE_STRING:
        return _text(max_length), field.default_value
    if field.enum_type is not None and not field.has_presence:
        return _type(field), ...
    if field.has_presence and (message is None or message.full_name != STRUCT):
        return _type(field) | None, None
    return _type(field), {} if message is not None else field.default_value


def _text(max_length: int) -> Any:
    return Annotated[str, _shown(maxLength=max_length)]


def _shown(**bound: int) -> Any:
    """Shows a bound in the schema; `wire.unpack` checks it, for REST and gRPC alike."""
    return Field(json_schema_extra={key: most for key, most in bound.items() if most})


def _type(field: FieldDescriptor, datatypes: Sequence[str] = ()) -> Any:
    """Returns the type of one value; `datatypes` are those of a map's tensors."""
    if field.message_type is common_pb2.Tensor.DESCRIPTOR:
        return Annotated[schema_of(field.message_type), OrList(datatypes or datatypes_of(field) or _DATATYPES)]
    if field.message_type is not None:
        return dict[str, JsonValue] if field.message_type.full_name == STRUCT else schema_of(field.message_type)
    if field.enum_type is not None:
        return Literal[wire.enum_names(field.enum_type)]
    if field.type in _INTEGERS:
        low, high = _INTEGERS[field.type]
        return Annotated[int, Field(ge=low, le=high)]
    return {
        FieldDescriptor.TYPE_BYTES: Base64,
        FieldDescriptor.TYPE_BOOL: bool,
        FieldDescriptor.TYPE_FLOAT: float,
        FieldDescriptor.TYPE_DOUBLE: float,
    }[field.type]
