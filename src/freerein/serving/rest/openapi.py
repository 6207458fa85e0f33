"""The OpenAPI document of a service, made from its methods."""

from collections.abc import Sequence
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from google.protobuf.descriptor import Descriptor

from freerein.api.common.v1 import common_pb2
from freerein.serving.error_replies import PROBLEM_MEDIA_TYPE, TITLES
from freerein.serving.methods import Method, RestForm
from freerein.serving.rest.comments import comment_of
from freerein.serving.rest.schemas import schema_of

MEDIA_TYPES: dict[RestForm, str] = {
    "reply": "application/json",
    "events": "text/event-stream",
    "file": "application/octet-stream",
}
_SCHEMAS = "#/components/schemas/{model}"
_PROBLEMS = {
    str(status): {
        "description": f"{TITLES[status]}.{' See Retry-After.' if status in (429, 503) else ''}",
        "content": {PROBLEM_MEDIA_TYPE: {"schema": {"$ref": _SCHEMAS.format(model="Problem")}}},
    }
    for status in (400, 401, 404, 409, 413, 415, 422, 429, 501, 503, 504)
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


def openapi_document(app: FastAPI, methods: Sequence[Method]) -> dict[str, Any]:
    """Returns the OpenAPI document of an app that serves these methods."""
    document = get_openapi(title=app.title, version=app.version, routes=[])
    schemas: dict[str, Any] = {"Problem": _PROBLEM_SCHEMA}
    for method in methods:
        document["paths"][method.path] = _operation(method, schemas)
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


def _operation(method: Method, schemas: dict[str, Any]) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "string"}
    if method.rest_form == "reply":
        schema = _reference(method.descriptor.output_type, "serialization", schemas)
    success = {
        "description": comment_of(method.descriptor.output_type.full_name),
        "content": {MEDIA_TYPES[method.rest_form]: {"schema": schema}},
    }
    operation: dict[str, Any] = {
        "operationId": method.name,
        "tags": [method.descriptor.containing_service.name],
        "summary": comment_of(method.descriptor.full_name),
        "responses": {"200": success, **_PROBLEMS},
    }
    if method.reads:
        return {"get": {**operation, "parameters": _parameters(method.descriptor.input_type)}}
    request = {"schema": _reference(method.descriptor.input_type, "validation", schemas)}
    content = {"application/json": request, "multipart/form-data": {"schema": _parts(method.descriptor.input_type)}}
    return {"post": {**operation, "requestBody": {"required": True, "content": content}}}


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


def _parameters(message: Descriptor, prefix: str = "") -> list[dict[str, Any]]:
    parameters: list[dict[str, Any]] = []
    properties = schema_of(message).model_json_schema().get("properties", {})
    for field in message.fields:
        if field.message_type is not None:
            parameters += _parameters(field.message_type, f"{prefix}{field.name}.")
        else:
            schema = dict(properties[field.name])
            description = schema.pop("description")
            name = prefix + field.name
            parameters.append({"name": name, "in": "query", "description": description, "schema": schema})
    return parameters
