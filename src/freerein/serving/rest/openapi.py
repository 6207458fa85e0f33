"""The OpenAPI document of a service, made from its methods."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from google.protobuf.descriptor import Descriptor

from freerein import __version__
from freerein.api.common.v1 import common_pb2
from freerein.serving.error_replies import PROBLEM_MEDIA_TYPE, TITLES
from freerein.serving.methods import Method, RestForm, rest_path
from freerein.serving.rest import pictures, tensor_lists
from freerein.serving.rest.comments import comment_of
from freerein.serving.rest.examples import ID, JOB, curl_commands, example_of, example_parts
from freerein.serving.rest.schemas import STRUCT, schema_of

MEDIA_TYPES: dict[RestForm, str] = {
    "reply": "application/json",
    "events": "text/event-stream",
    "file": "application/octet-stream",
}
_CALLS = (
    "Calls that only read are `GET` with their fields in the query, others `POST` with a JSON object or, with files, "
    "`multipart/form-data`. An error is a problem document (RFC 9457): `detail` says what was wrong, `hint` what to "
    "do. A tensor is `{datatype, shape, raw}`, `raw` in base64, or a nested list. With a token, every call but health "
    "checks and this page needs the header `Authorization: Bearer <token>`."
)
_EVENTS = (
    "server-sent events, each with a number as its `id` and JSON as its `data`. The header `Last-Event-ID` resumes "
    "after an event. A comment every few seconds keeps the connection open; the stream ends with what it watches."
)
_TENSORS = {
    "name": tensor_lists.PARAMETER,
    "in": "query",
    "description": f"`{tensor_lists.LIST}` for the reply's tensors as lists, nested by axis; those of more than "
    f"{tensor_lists.MAX_LISTED} elements stay in base64.",
    "schema": {"type": "string", "enum": [tensor_lists.LIST]},
}
_SCHEMAS = "#/components/schemas/{model}"
_PROBLEMS = {
    str(status): {
        "description": f"{TITLES[status]}.{' See Retry-After.' if status in (429, 503) else ''}",
        "content": {PROBLEM_MEDIA_TYPE: {"schema": {"$ref": _SCHEMAS.format(model="Problem")}}},
    }
    for status in (400, 401, 404, 408, 409, 413, 415, 422, 429, 501, 503, 504)
}
_PROBLEM_SCHEMA = {
    "type": "object",
    "description": "RFC 9457 problem details.",
    "required": ["type", "title", "status", "code", "detail", "field", "hint", "request_id"],
    "properties": {
        "status": {"type": "integer"},
        **{key: {"type": "string"} for key in ("type", "title", "code", "detail", "field", "hint", "request_id")},
    },
}


def api_title(service: str) -> str:
    """Returns the title of a service's REST API."""
    return f"freerein {service}"


def openapi_document(
    methods: Sequence[Method],
    *,
    service: str,
    has_token: bool = False,
    websocket: str = "",
    configs: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Returns the OpenAPI document of a service, whose commands call it at `examples.BASE_URL`.

    Args:
        methods: Its methods; those of gRPC alone are named.
        service: Its name.
        has_token: Whether calls need a token.
        websocket: What its WebSocket does; empty for none.
        configs: JSON schemas of the field `config`, by message of a request.
    """
    served = [method for method in methods if method.rest_form != "none"]
    info = {"title": api_title(service), "version": __version__, "description": _about(methods, websocket)}
    document: dict[str, Any] = {"openapi": "3.1.0", "info": info, "servers": [{"url": "/"}], "paths": {}}
    schemas: dict[str, Any] = {"Problem": _PROBLEM_SCHEMA}
    for method in served:
        document["paths"][method.path] = _operation(method, schemas, service, has_token)
    for message, config in (configs or {}).items():
        schemas[message]["properties"]["config"] |= config
        schemas[message]["properties"]["config"].pop("additionalProperties", None)
    document["components"] = {
        "schemas": schemas,
        "securitySchemes": {"token": {"type": "http", "scheme": "bearer", "description": "FREEREIN_TOKEN."}},
    }
    document["security"] = [{"token": []}] if has_token else [{}, {"token": []}]
    services = {
        method.descriptor.containing_service.full_name: method.descriptor.containing_service for method in methods
    }
    document["tags"] = [{"name": each.name, "description": comment_of(each.full_name)} for each in services.values()]
    return document


def _about(methods: Sequence[Method], websocket: str) -> str:
    """Returns what is said of the whole API, as Markdown."""
    only_grpc = [method for method in methods if method.rest_form == "none"]
    events = [method for method in methods if method.rest_form == "events"]
    owners = dict.fromkeys(method.descriptor.containing_service.full_name for method in methods)
    paragraphs = [" ".join(filter(None, map(comment_of, owners))), _CALLS]
    if events:
        named = ", ".join(f"`GET {method.path}`" for method in events)
        paragraphs.append(f"**Event streams.** {named}: {_EVENTS}")
    if websocket:
        paragraphs.append(f"**WebSocket.** At `/` of this port: {websocket}")
    if only_grpc:
        streams = [f"- `{method.name}`: {comment_of(method.descriptor.full_name)}" for method in only_grpc]
        paragraphs.append("\n".join(["**Over gRPC alone**, streams of messages in both directions:", "", *streams]))
    return "\n\n".join(filter(None, paragraphs))


def _operation(method: Method, schemas: dict[str, Any], service: str, has_token: bool) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "string"}
    if method.rest_form != "file":
        schema = _reference(method.descriptor.output_type, "serialization", schemas)
    if method.rest_form == "events":
        schema = _event(schema)
    success: dict[str, Any] = {
        "description": comment_of(method.descriptor.output_type.full_name),
        "content": {MEDIA_TYPES[method.rest_form]: {"schema": schema}},
    }
    if pictures.holds_frames(method.descriptor.output_type):
        success["content"][pictures.MEDIA_TYPE] = {"schema": {"type": "string", "format": "binary"}}
    comment, example = comment_of(method.descriptor.full_name), example_of(method, service)
    operation: dict[str, Any] = {
        "operationId": method.name,
        "tags": [method.descriptor.containing_service.name],
        "summary": re.split(r"(?<=[^.])[.;:](?:\s|$)", comment)[0],
        "description": "\n\n".join([comment, *_notes(method, example), *_commands(method, service, has_token)]),
        "responses": {"200": success, **_PROBLEMS},
    }
    if method.reads:
        return {"get": {**operation, "parameters": _parameters(method.descriptor.input_type, example)}}
    request = {"schema": _reference(method.descriptor.input_type, "validation", schemas), "example": example}
    parts = {"schema": _parts(method.descriptor.input_type), "example": _texts(method, service)}
    content = {"application/json": request, "multipart/form-data": parts}
    if _holds_tensors(method.descriptor.output_type):
        operation["parameters"] = [_TENSORS]
    return {"post": {**operation, "requestBody": {"required": True, "content": content}}}


def _notes(method: Method, example: Mapping[str, Any]) -> Iterator[str]:
    """Yields what an example needs, and how a stream is read."""
    if method.rest_form == "events":
        yield f"An event stream: {_EVENTS}"
    if example.get("session") == ID:
        yield f"Replace `session` by one that `{rest_path('CreateSession')}` returned."
    elif example.get("run") == ID:
        yield f"Replace `run` by one of kind `ppo` that has succeeded; `{rest_path('ListRuns')}` lists them."
    elif JOB in example.values():
        start = "StartFit" if "Fit" in method.name else "StartRun"
        yield f"The example names what the example of `{rest_path(start)}` starts."
    elif method.name == "StartFit":
        yield f"The example needs the dataset that the example of the orchestrator's `{rest_path('StartRun')}` records."


def _commands(method: Method, service: str, has_token: bool) -> Iterator[str]:
    for said, command in curl_commands(method, service, has_token=has_token).items():
        yield "\n\n".join(filter(None, [said, f"```sh\n{command}\n```"]))


def _event(data: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the schema of each event of a stream; before OpenAPI 3.2, it stands where that of a document does."""
    text = {"type": "string", "contentMediaType": "application/json", "contentSchema": data}
    return {
        "type": "object",
        "properties": {
            "id": {"type": "string", "description": "The number of the event, for the header `Last-Event-ID`."},
            "data": {**text, "description": "What happened, as JSON."},
        },
        "required": ["id", "data"],
    }


def _texts(method: Method, service: str) -> dict[str, Any]:
    """Returns the text parts of an example; files cannot be shown."""
    texts: dict[str, list[str]] = {}
    for name, part in example_parts(method, service):
        if isinstance(part, str):
            texts.setdefault(name, []).append(part)
    fields = method.descriptor.input_type.fields_by_name
    return {name: parts if name in fields and fields[name].is_repeated else parts[0] for name, parts in texts.items()}


def _holds_tensors(message: Descriptor) -> bool:
    """Returns whether a message, or one in it, has a tensor."""
    inner = [field.message_type for field in message.fields if field.message_type is not None]
    return any(
        each is common_pb2.Tensor.DESCRIPTOR or _holds_tensors(each) for each in inner if each.full_name != STRUCT
    )


def _parts(message: Descriptor) -> dict[str, Any]:
    """Returns the schema of a multipart body; see `freerein.serving.rest.body`."""
    properties = {}
    for field in message.fields:
        part: dict[str, Any] = {"type": "string"}
        if field.message_type is common_pb2.Image.DESCRIPTOR:
            part["format"] = "binary"
        described = {"description": comment_of(field.full_name)}
        properties[field.name] = (
            {"type": "array", "items": part, **described} if field.is_repeated else part | described
        )
    return {
        "type": "object",
        "description": "A file is an image. A part for another message is JSON, or one for each field: `model.name`. "
        "A name may repeat where the field is a list.",
        "properties": properties,
    }


def _reference(message: Descriptor, mode: Any, schemas: dict[str, Any]) -> dict[str, str]:
    """Adds the JSON schema of a message, and those it refers to, to the components; returns the reference to it."""
    schema = schema_of(message).model_json_schema(ref_template=_SCHEMAS, mode=mode)
    schemas.update(schema.pop("$defs", {}))
    schemas[message.name] = schema
    return {"$ref": _SCHEMAS.format(model=message.name)}


def _parameters(message: Descriptor, example: Mapping[str, Any], prefix: str = "") -> list[dict[str, Any]]:
    parameters: list[dict[str, Any]] = []
    properties = schema_of(message).model_json_schema().get("properties", {})
    for field in message.fields:
        if field.message_type is not None:
            parameters += _parameters(field.message_type, example.get(field.name, {}), f"{prefix}{field.name}.")
        else:
            schema = dict(properties[field.name])
            description = schema.pop("description")
            name = prefix + field.name
            shown = {"example": example[field.name]} if field.name in example else {}
            parameters.append({"name": name, "in": "query", "description": description, "schema": schema, **shown})
    return parameters
