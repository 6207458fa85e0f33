"""The OpenAPI document of a service, made from its methods."""

from collections.abc import Mapping, Sequence
from typing import Any

from google.protobuf.descriptor import Descriptor

from freerein import __version__
from freerein.api.common.v1 import common_pb2
from freerein.serving.error_replies import PROBLEM_MEDIA_TYPE, TITLES
from freerein.serving.methods import Method, RestForm
from freerein.serving.rest import pictures, tensor_lists
from freerein.serving.rest.comments import comment_of
from freerein.serving.rest.examples import curl_command, example_of, example_parts
from freerein.serving.rest.schemas import STRUCT, schema_of

MEDIA_TYPES: dict[RestForm, str] = {
    "reply": "application/json",
    "events": "text/event-stream",
    "file": "application/octet-stream",
}
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


def openapi_document(methods: Sequence[Method], *, service: str) -> dict[str, Any]:
    """Returns the OpenAPI document of these methods of a service."""
    info = {"title": api_title(service), "version": __version__}
    document: dict[str, Any] = {"openapi": "3.1.0", "info": info, "paths": {}}
    schemas: dict[str, Any] = {"Problem": _PROBLEM_SCHEMA}
    for method in methods:
        document["paths"][method.path] = _operation(method, schemas, service)
    document["components"] = {
        "schemas": schemas,
        "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
    }
    document["security"] = [{}, {"token": []}]
    services = {
        method.descriptor.containing_service.full_name: method.descriptor.containing_service for method in methods
    }
    document["tags"] = [{"name": each.name, "description": comment_of(each.full_name)} for each in services.values()]
    return document


def _operation(method: Method, schemas: dict[str, Any], service: str) -> dict[str, Any]:
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
    operation: dict[str, Any] = {
        "operationId": method.name,
        "tags": [method.descriptor.containing_service.name],
        "summary": comment_of(method.descriptor.full_name),
        "responses": {"200": success, **_PROBLEMS},
    }
    if command := curl_command(method, service):
        operation["description"] = f"```\n{command}\n```"
    if method.reads:
        return {"get": {**operation, "parameters": _parameters(method.descriptor.input_type, example_of(method))}}
    request = {"schema": _reference(method.descriptor.input_type, "validation", schemas), "example": example_of(method)}
    parts = {"schema": _parts(method.descriptor.input_type), "example": _texts(method)}
    content = {"application/json": request, "multipart/form-data": parts}
    if _holds_tensors(method.descriptor.output_type):
        operation["parameters"] = [_TENSORS]
    return {"post": {**operation, "requestBody": {"required": True, "content": content}}}


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


def _texts(method: Method) -> dict[str, Any]:
    """Returns the text parts of an example; files cannot be shown."""
    texts: dict[str, list[str]] = {}
    for name, part in example_parts(method):
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
            parameters += _parameters(field.message_type, {}, f"{prefix}{field.name}.")
        else:
            schema = dict(properties[field.name])
            description = schema.pop("description")
            name = prefix + field.name
            shown = {"example": example[field.name]} if field.name in example else {}
            parameters.append({"name": name, "in": "query", "description": description, "schema": schema, **shown})
    return parameters
