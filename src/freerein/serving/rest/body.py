"""Decodes the body or query of a REST request into its dataclass.

A body is JSON or multipart/form-data. In multipart and in a query, a name is the dotted path of a field
(`model.name`), a repeated name appends, a part for a message is JSON, a file is an image or the bytes of a field of
bytes, and anything else is text.

    curl -F images=@0.png -F images=@1.png -F smoothing=1.5 localhost:8101/v1/segment
"""

import asyncio
import json
import re
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Iterable
from contextlib import suppress
from typing import Any, TypeVar

import numpy as np
import orjson
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from pydantic import ValidationError
from python_multipart.multipart import parse_options_header
from starlette.datastructures import FormData
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect, Request

from freerein import images, wire
from freerein.atomic_files import storage_errors
from freerein.errors import Cancelled, InvalidInput, MalformedRequest, UnsupportedMedia
from freerein.serving.limits import FEW_VALUES, MAX_INLINE_BYTES, MAX_INLINE_IMAGE_BYTES, MAX_VALUES
from freerein.serving.rest.field_names import unknown_field
from freerein.serving.rest.schemas import STRUCT, schema_of
from freerein.unknown_names import quoted_name

T = TypeVar("T")

_MAX_PARTS = 20_000
_MAX_PART_BYTES = 64 * 2**20
_STRING = re.compile(rb'"(?:[^"\\]++|\\.)*+"', re.DOTALL)


async def read(request: Request, cls: type[T]) -> T:
    """Returns the dataclass in a request's body.

    Raises:
        UnsupportedMedia: Neither `application/json` nor `multipart/form-data`, or a charset other than UTF-8.
        MalformedRequest: The multipart framing is broken.
        InvalidInput: The content does not match `cls`.
        TooLarge: The body exceeds its limit.
    """
    media_type, parameters = parse_options_header(request.headers.get("content-type", ""))
    if parameters.get(b"charset", b"utf-8").lower() not in (b"utf-8", b"utf8"):
        raise UnsupportedMedia(
            "The body must be in UTF-8; its Content-Type names another charset.", hint="Omit the charset."
        )
    if media_type == b"application/json":
        body = await _receive(request)
        if _is_quick(body):
            return _parse_json(body, cls, load=orjson.loads)
        return await asyncio.to_thread(_parse_json, body, cls, load=_loads)
    if media_type == b"multipart/form-data":
        return await _read_multipart(request, cls)
    raise UnsupportedMedia(
        "The body must be application/json or multipart/form-data; its Content-Type names another, or none.",
        hint="With curl: --json '{...}', or -F field=value.",
    )


def read_query(request: Request, cls: type[T]) -> T:
    """Returns the dataclass in a request's query; InvalidInput when a parameter is unknown, repeated or invalid."""
    return _from_parts(request.query_params.multi_items(), cls)


async def _receive(request: Request) -> bytes:
    """Returns the whole body. Starlette's own would also keep it until the reply."""
    try:
        return b"".join([part async for part in request.stream()])
    except ClientDisconnect:
        raise _disconnected() from None


def _is_quick(body: bytes) -> bool:
    """Returns whether to parse JSON takes so little time that the event loop may wait for it; then it is bounded."""
    if not MAX_INLINE_BYTES < len(body) <= MAX_INLINE_IMAGE_BYTES:
        return len(body) <= MAX_INLINE_BYTES
    return _count(body, b",[{") <= FEW_VALUES


def _disconnected() -> Cancelled:
    return Cancelled("The client disconnected before the body was complete.")


def _parse_json(body: bytes, cls: type[T], *, load: Callable[[bytes], Any]) -> T:
    try:
        value = load(body)
    except orjson.JSONDecodeError as error:
        raise InvalidInput(
            f"The body must be JSON in UTF-8 with finite numbers; {_place(body, error)}.",
            hint="Quotes are double, no comma ends a list. NaN, Infinity, a byte-order mark, lone surrogates and very "
            "deep nesting are not allowed.",
        ) from None
    _check_keys(body, value)
    return _validated(value, cls, strict=True)


def _place(text: bytes, error: orjson.JSONDecodeError) -> str:
    """Returns where a text is no JSON, and why; not what stands there. Lines and columns count characters from 1."""
    try:
        text.decode()
    except UnicodeDecodeError as bad:  # which orjson does not locate
        lines = text[: bad.start].decode().split("\n")
        return f"line {len(lines)}, column {len(lines[-1]) + 1}: not UTF-8"
    return f"line {error.lineno}, column {error.colno}: {error.msg}"


def _loads(data: bytes) -> Any:
    """Parses JSON of a bounded number of values, since a value of two bytes takes about sixty in memory."""
    if len(data) > MAX_VALUES and _count(data, b",[{") > MAX_VALUES:
        raise InvalidInput(
            f"JSON may hold at most {MAX_VALUES} values; got more.", hint="Send arrays as tensors: raw is base64."
        )
    return orjson.loads(data)


def _count(data: bytes, characters: bytes) -> int:
    """Returns how often any of some characters occurs, in a quarter of the time of `bytes.count`."""
    codes = np.frombuffer(data, np.uint8)
    return sum(int(np.count_nonzero(codes == character)) for character in characters)


def _check_keys(text: bytes, value: object) -> None:
    """Raises InvalidInput where an object had duplicate keys: its JSON has more colons outside strings than pairs."""
    pairs = _count_pairs(value)
    if _count(text, b":") != pairs and _STRING.sub(b"", text).count(b":") != pairs:
        raise InvalidInput(
            f"Keys of a JSON object must be unique; {_repeated_key(text)} is repeated.", hint="Send each field once."
        )


def _repeated_key(text: bytes) -> str:
    """Returns a repeated key of JSON, quoted, or another word for it."""
    repeated: list[str] = []

    def note(pairs: list[tuple[str, Any]]) -> None:
        repeated.extend(name for name, count in Counter(name for name, _ in pairs).items() if count > 1)

    with suppress(RecursionError):  # Python's parser is stricter about depth
        json.loads(text, object_pairs_hook=note)
    return quoted_name(repeated[0]) if repeated else "one"


def _count_pairs(value: object) -> int:
    count, rest = 0, [value]
    while rest:
        item = rest.pop()
        if isinstance(item, dict):
            count += len(item)
            rest.extend(item.values())
        elif isinstance(item, list):
            rest.extend(item)
    return count


async def _read_multipart(request: Request, cls: type[T]) -> T:
    parser = _StrictParser(
        request.headers, request.stream(), max_files=_MAX_PARTS, max_fields=_MAX_PARTS, max_part_size=_MAX_PART_BYTES
    )
    try:
        with storage_errors("temporary files"):
            form = await parser.parse()
    except ClientDisconnect:
        raise _disconnected() from None
    except (MultiPartException, UnicodeError) as error:
        found = error.message.rstrip(".") if isinstance(error, MultiPartException) else "a name or text is not UTF-8"
        raise MalformedRequest(
            f"The body must be well-formed multipart/form-data of at most {_MAX_PARTS} parts: {found}.",
            hint="Let the HTTP client write the boundary: with curl, -F field=value.",
        ) from None
    try:
        parts = [(name, part if isinstance(part, str) else await part.read()) for name, part in form.multi_items()]
    finally:
        await form.close()
    return await asyncio.to_thread(_from_parts, parts, cls)


class _StrictParser(MultiPartParser):
    """Starlette's parser, and an error where the body ends before its last boundary, which Starlette accepts."""

    _ended = False

    def on_end(self) -> None:
        self._ended = True

    async def parse(self) -> FormData:
        self.stream = self._until_boundary(self.stream)
        return await super().parse()

    async def _until_boundary(self, stream: AsyncGenerator[bytes, None]) -> AsyncGenerator[bytes, None]:
        async for chunk in stream:
            yield chunk
        if not self._ended:
            raise MultiPartException("The last boundary is missing.")


def _from_parts(parts: Iterable[tuple[str, bytes | str]], cls: type[T]) -> T:
    """Builds the dataclass from (dotted field name, content) pairs."""
    tree: dict[str, Any] = {}
    for name, content in parts:
        node, message = tree, wire.descriptor_of(cls)
        *parents, last = name.split(".")
        for parent in parents:
            field = _field(message, parent, cls)
            if field.message_type is None or field.is_repeated or field.message_type.full_name == STRUCT:
                raise _no_message(field)
            message = field.message_type
            node = node.setdefault(parent, {})
            if not isinstance(node, dict):
                raise _repeated(field)
        _insert(node, _field(message, last, cls), content)
    return _validated(tree, cls, strict=False)


def _insert(node: dict[str, Any], field: FieldDescriptor, content: bytes | str) -> None:
    value = _part_value(field, content)
    if field.name not in node:
        node[field.name] = [value] if _appends(field, content) else value
    elif _appends(field, content) and isinstance(node[field.name], list):
        node[field.name].append(value)
    else:
        raise _repeated(field)


def _appends(field: FieldDescriptor, content: bytes | str) -> bool:
    return field.is_repeated and (isinstance(content, bytes) or field.message_type is None)


def _part_value(field: FieldDescriptor, content: bytes | str) -> Any:
    if isinstance(content, bytes) and field.type == FieldDescriptor.TYPE_BYTES:
        return content
    if isinstance(content, bytes):
        return {"encoding": images.sniff(content, field=field.name), "data": content}
    if field.message_type is None:
        return content
    try:
        value = _loads(content.encode())
    except orjson.JSONDecodeError as error:
        raise InvalidInput(
            f"`{field.name}` must be JSON in a text part; {_place(content.encode(), error)}.",
            field=field.name,
            hint="For an image, send a file: with curl, -F images=@frame.png.",
        ) from None
    _check_keys(content.encode(), value)
    return value


def _field(message: Descriptor, name: str, cls: type[object]) -> FieldDescriptor:
    field = message.fields_by_name.get(name)
    if field is None:
        raise unknown_field(name, message, wire.descriptor_of(cls))
    return field


def _repeated(field: FieldDescriptor) -> InvalidInput:
    return InvalidInput(f"`{field.name}` must be given once; it is repeated.", field=field.name, hint="Send it once.")


def _no_message(field: FieldDescriptor) -> InvalidInput:
    return InvalidInput(
        f"Every part or parameter must be a field of the request; `{field.name}` has none with names.",
        field=field.name,
        hint="Dots lead into messages: model.name. GET /openapi.json lists the fields.",
    )


def _validated(value: object, cls: type[T], *, strict: bool) -> T:
    schema = schema_of(wire.descriptor_of(cls))
    try:
        return wire.unpack(schema.model_validate(value, strict=strict), cls)
    except ValidationError as error:
        raise _invalid(error, wire.descriptor_of(cls)) from None


def _invalid(error: ValidationError, message: Descriptor) -> InvalidInput:
    """Returns pydantic's first error, without the input."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    field = _dotted_name(first["loc"], message)
    if first["type"] == "extra_forbidden":
        return unknown_field(str(first["loc"][-1]), _message_at(first["loc"][:-1], message), message)
    return InvalidInput(
        f"`{field}` is invalid: {first['msg']} ({error.error_count()} errors).",
        field=field,
        hint="GET /openapi.json describes every field.",
    )


def _message_at(location: Iterable[int | str], message: Descriptor) -> Descriptor:
    """Returns the message at a place in a request; in a map, the message of its values."""
    for part in location:
        field = message.fields_by_name.get("value" if message.GetOptions().map_entry else str(part))
        message = (field and field.message_type) or message
    return message


def _dotted_name(location: Iterable[int | str], message: Descriptor | None) -> str:
    """Returns a field's dotted name, up to a key that the client chose: of a map, or of free-form values."""
    names: list[str] = []
    for part in location:
        if isinstance(part, str):
            if message is None or message.GetOptions().map_entry or message.full_name == STRUCT:
                break
            if part not in message.fields_by_name:
                break
            message = message.fields_by_name[part].message_type
        names.append(str(part))
    return ".".join(names)
