"""A REST request's bytes to a dataclass: JSON, or multipart, or a query.

One rule for the last two: a part or parameter is named by the dotted path of its field (`model.name`); a repeated name
appends; a part for a message is JSON, a file is an image, anything else is plain text.

    curl -F images=@0.png -F images=@1.png -F smoothing=1.5 localhost:8101/v1/segment
"""

import asyncio
import re
from collections.abc import AsyncGenerator, Iterable
from typing import Any, TypeVar, cast

import orjson
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from pydantic import ValidationError
from python_multipart.multipart import parse_options_header
from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect, Request

from freerein import images, wire
from freerein.errors import Cancelled, InvalidInput, MalformedRequest, UnsupportedMedia
from freerein.serving.schemas import STRUCT, schema_of

T = TypeVar("T")

_INLINE_BYTES = 64 * 1024  # above it, parsing leaves the event loop
_PARTS = 20_000
_PART_BYTES = 64 * 2**20
_VALUES = 1_000_000
_LONGEST_FIELD = 200
_STRING = re.compile(rb'"(?:[^"\\]++|\\.)*+"', re.DOTALL)


async def read(request: Request, cls: type[T]) -> T:
    """Returns the dataclass that a request's body holds, in whichever of the two media types it came.

    Raises:
        UnsupportedMedia: Neither `application/json` nor `multipart/form-data`, or another charset than UTF-8.
        MalformedRequest: The multipart framing is broken.
        InvalidInput: The content is not what `cls` says.
        TooLarge: Over the body limit.
    """
    media_type, parameters = parse_options_header(request.headers.get("content-type", ""))
    if parameters.get(b"charset", b"utf-8").lower() not in (b"utf-8", b"utf8"):
        raise UnsupportedMedia(
            "The body must be in UTF-8; its Content-Type names another charset.", hint="Leave it out."
        )
    if media_type == b"application/json":
        body = await _receive(request)
        parse = _parse_json if len(body) <= _INLINE_BYTES else _parse_json_in_thread
        result = parse(body, cls)
        return cast(T, await result if asyncio.iscoroutine(result) else result)
    if media_type == b"multipart/form-data":
        return await _read_multipart(request, cls)
    raise UnsupportedMedia(
        "The body must be application/json or multipart/form-data; its Content-Type names another, or none.",
        hint="With curl: --json '{...}', or -F field=value.",
    )


def read_query(request: Request, cls: type[T]) -> T:
    """Returns the dataclass that a request's query holds.

    Raises:
        InvalidInput: An unknown, repeated or ill-formed parameter.
    """
    return _from_parts(request.query_params.multi_items(), cls)


async def _receive(request: Request) -> bytes:
    try:
        return await request.body()
    except ClientDisconnect:
        raise Cancelled("The caller went away before the body was complete.") from None


async def _parse_json_in_thread(body: bytes, cls: type[T]) -> T:
    return await asyncio.to_thread(_parse_json, body, cls)


def _parse_json(body: bytes, cls: type[T]) -> T:
    try:
        value = _loads(body)
    except orjson.JSONDecodeError:
        raise InvalidInput(
            "The body must be JSON in UTF-8 with finite numbers; it could not be read as that.",
            hint="NaN, Infinity, a byte-order mark, lone surrogates and very deep nesting are not JSON.",
        ) from None
    if _repeats_a_key(body, value):
        raise InvalidInput(
            "Every key of a JSON object must be there once; one is repeated.", hint="Send each field once."
        )
    return _validated(value, cls, strict=True)


def _loads(data: bytes) -> Any:
    """Returns what JSON says, unless it would take much more memory than its bytes: values of two bytes take sixty."""
    if sum(map(data.count, (b",", b"[", b"{"))) > _VALUES:
        raise InvalidInput(
            f"JSON may hold at most {_VALUES} values; it holds more.", hint="Send arrays as tensors: raw is base64."
        )
    return orjson.loads(data)


def _repeats_a_key(body: bytes, value: object) -> bool:
    """Tells whether a parsed body had more keys than were kept: each pair has one colon outside of strings."""
    kept = _count_pairs(value)
    return body.count(b":") != kept and _STRING.sub(b"", body).count(b":") != kept


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
    parser = _WholeParser(
        request.headers, request.stream(), max_files=_PARTS, max_fields=_PARTS, max_part_size=_PART_BYTES
    )
    try:
        form = await parser.parse()
    except ClientDisconnect:
        raise Cancelled("The caller went away before the body was complete.") from None
    except (MultiPartException, UnicodeError):
        raise MalformedRequest(
            f"The body must be well-formed multipart/form-data of at most {_PARTS} parts; it is not.",
            hint="Let your HTTP client write the boundary: with curl, -F field=value.",
        ) from None
    try:
        parts = [(name, await _content(part)) for name, part in form.multi_items()]
    finally:
        await form.close()
    return await asyncio.to_thread(_from_parts, parts, cls)


class _WholeParser(MultiPartParser):
    """Starlette's parser, which by itself takes a body that breaks off before its last boundary for a whole one."""

    _ended = False

    def on_end(self) -> None:
        self._ended = True

    async def parse(self) -> FormData:
        self.stream = self._to_its_end(self.stream)
        return await super().parse()

    async def _to_its_end(self, stream: AsyncGenerator[bytes, None]) -> AsyncGenerator[bytes, None]:
        async for chunk in stream:
            yield chunk
        if not self._ended:
            raise MultiPartException("The last boundary is missing.")


async def _content(part: UploadFile | str) -> bytes | str:
    return part if isinstance(part, str) else await part.read()


def _from_parts(parts: Iterable[tuple[str, bytes | str]], cls: type[T]) -> T:
    """Builds the request from (dotted name, content) pairs."""
    tree: dict[str, Any] = {}
    for name, content in parts:
        node, message = tree, wire.descriptor_of(cls)
        *parents, last = name.split(".")
        for parent in parents:
            field = _field(message, parent)
            if field.message_type is None or field.is_repeated or field.message_type.full_name == STRUCT:
                raise _no_such_field()
            message = field.message_type
            node = node.setdefault(parent, {})
            if not isinstance(node, dict):
                raise _repeated(field)
        _put(node, _field(message, last), content)
    return _validated(tree, cls, strict=False)


def _put(node: dict[str, Any], field: FieldDescriptor, content: bytes | str) -> None:
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
    if isinstance(content, bytes):
        return {"encoding": images.sniff(content, field=field.name), "data": content}
    if field.message_type is None:
        return content
    try:
        return _loads(content.encode())
    except orjson.JSONDecodeError:
        raise InvalidInput(
            f"`{field.name}` must be JSON in a text part; it could not be read as that.",
            field=field.name,
            hint="For an image, send a file: with curl, -F images=@frame.png.",
        ) from None


def _field(message: Descriptor, name: str) -> FieldDescriptor:
    field = message.fields_by_name.get(name)
    if field is None:
        raise _no_such_field()
    return field


def _repeated(field: FieldDescriptor) -> InvalidInput:
    return InvalidInput(f"`{field.name}` must be there once; it is repeated.", field=field.name, hint="Send it once.")


def _no_such_field() -> InvalidInput:
    return InvalidInput(
        "Every part or parameter must be named like a field of the request; one is not.",
        hint="Dots lead into messages: model.name. GET /openapi.json lists the fields.",
    )


def _validated(value: object, cls: type[T], *, strict: bool) -> T:
    schema = schema_of(wire.descriptor_of(cls))
    try:
        return wire.unpack(schema.model_validate(value, strict=strict), cls)
    except ValidationError as error:
        raise _invalid(error) from None


def _invalid(error: ValidationError) -> InvalidInput:
    """Returns the first complaint of pydantic, without the input that it is about."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    known = [str(part) for part in first["loc"] if isinstance(part, int) or part.isidentifier()]
    field = ".".join(known)[:_LONGEST_FIELD]
    if first["type"] == "extra_forbidden":
        return InvalidInput(
            "The request must have no field but its own; there is another.",
            hint="GET /openapi.json lists the fields.",
        )
    return InvalidInput(
        f"`{field}` is not as expected: {first['msg']} ({error.error_count()} such problems).",
        field=field,
        hint="GET /openapi.json describes every field.",
    )
