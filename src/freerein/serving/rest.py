"""The REST door: a FastAPI app made from a service's methods, health, metrics and one way of answering errors."""

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, aclosing
from dataclasses import replace
from functools import cache
from typing import Any, cast

import orjson
from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from google.protobuf.descriptor import Descriptor
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from freerein import __version__, wire
from freerein.errors import Cancelled, DeadlineExceeded, InvalidInput, NotFound, ServiceError
from freerein.serving import body, problems
from freerein.serving.edge import Edge
from freerein.serving.health import Health
from freerein.serving.limits import Limits, StreamSlots
from freerein.serving.methods import Method, RestForm
from freerein.serving.metrics import Metrics
from freerein.serving.schemas import schema_of

_log = logging.getLogger(__name__)
_MEDIA_TYPES: dict[RestForm, str] = {
    "reply": "application/json",
    "events": "text/event-stream",
    "file": "application/octet-stream",
}
_SCHEMAS = "#/components/schemas/{model}"
_PROBLEMS = {
    status: {
        "description": text,
        "content": {problems.MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
    }
    for status, text in (
        ("400", "The bytes are not a request."),
        ("401", "The token is missing or wrong."),
        ("404", "There is no such thing."),
        ("409", "It is not in the state that this call needs."),
        ("413", "Over a limit."),
        ("415", "A media type that is not served."),
        ("422", "A value is wrong."),
        ("429", "Too much at once: see Retry-After."),
        ("501", "This cannot do that."),
        ("503", "Not ready, draining, or a fault of the model: see Retry-After."),
        ("504", "Not done before the deadline."),
    )
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


def make_app(
    name: str,
    methods: Sequence[Method],
    *,
    health: Health,
    metrics: Metrics,
    limits: Limits,
    token: str = "",
) -> FastAPI:
    """Returns the REST door of a service.

    Args:
        name: The service's name.
        methods: What it answers; those that have no form over REST are left to gRPC.
        health: Tells readiness, and when draining.
        metrics: Where calls are counted.
        limits: The bounds.
        token: Bearer token that calls must carry; empty for none.
    """
    served = [method for method in methods if method.rest_form != "none"]
    app = FastAPI(title=f"freerein {name}", version=__version__, redoc_url=None, redirect_slashes=False)
    slots = StreamSlots(limits.streams)
    for method in served:
        answer = _unary(method, limits) if method.rest_form == "reply" else _stream(method, slots)
        app.add_route(method.path, answer, methods=["GET"] if method.reads else ["POST"], include_in_schema=False)
    _add_operations(app, health, metrics)
    app.add_exception_handler(ServiceError, _answer_service_error)
    app.add_exception_handler(HTTPException, _answer_http_exception)
    app.openapi = cache(lambda: _openapi(app, served))  # type: ignore[method-assign]  # FastAPI's documented way
    app.add_middleware(Edge, metrics=metrics, limits=limits, token=token, paths={method.path for method in served})
    return app


def _unary(method: Method, limits: Limits) -> Callable[[Request], Awaitable[Response]]:
    async def answer(request: Request) -> Response:
        if method.reads:
            message = body.read_query(request, method.request)
        else:
            message = await body.read(request, method.request)
        response = await _unless_disconnected(request, method.call(message), limits.unary_s)
        return Response(orjson.dumps(wire.to_json(response)), media_type="application/json")

    return answer


def _stream(method: Method, slots: StreamSlots) -> Callable[[Request], Awaitable[Response]]:
    """Answers with server-sent events, or with the bytes of a file.

    The id of an event is its `sequence`; the header `Last-Event-ID` resumes after it.
    """

    async def answer(request: Request) -> Response:
        message = body.read_query(request, method.request)
        if method.rest_form == "events" and (last := request.headers.get("last-event-id", "")).isdecimal():
            message = replace(message, from_sequence=int(last[:18]) + 1)
        async with AsyncExitStack() as resources:
            resources.enter_context(slots.hold())
            items = await resources.enter_async_context(aclosing(method.call(message)))
            # awaited before the reply begins, so that an unknown id is a 404, not a broken stream
            first = await _unless_disconnected(request, anext(items, None), None)
            write = _event if method.rest_form == "events" else _part
            return _Stream(_written(first, items, write), _MEDIA_TYPES[method.rest_form], resources.pop_all())

    return answer


class _Stream(StreamingResponse):
    """A streaming reply that releases what it holds when it ends, whether or not its body was iterated."""

    def __init__(self, content: AsyncIterator[bytes], media_type: str, resources: AsyncExitStack) -> None:
        super().__init__(content, media_type=media_type)
        self._resources = resources

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async with self._resources:
            await super().__call__(scope, receive, send)


async def _written(first: Any, rest: AsyncIterator[Any], write: Callable[[Any], bytes]) -> AsyncIterator[bytes]:
    if first is not None:
        yield write(first)
        async for item in rest:
            yield write(item)


def _event(item: Any) -> bytes:
    return b"id: %d\ndata: %s\n\n" % (item.sequence, orjson.dumps(wire.to_json(item)))


def _part(item: Any) -> bytes:
    return cast(bytes, item.data)


async def _unless_disconnected(request: Request, call: Awaitable[Any], timeout_s: float | None) -> Any:
    """Awaits a call; cancels it when its caller goes away or the time is up."""
    work = asyncio.ensure_future(call)
    gone = asyncio.ensure_future(_disconnected(request))
    try:
        await asyncio.wait({work, gone}, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        if work.done():
            return work.result()
        if gone.done():
            gone.result()  # raises when there is more to the request than may be
            raise Cancelled("The caller went away before the answer.")
        raise DeadlineExceeded(
            f"An answer was due within {timeout_s:g} s; it was not ready.", hint="Send less per call."
        )
    finally:
        work.cancel()
        gone.cancel()
        await asyncio.gather(work, gone, return_exceptions=True)  # a generator must not be closed while it runs


async def _disconnected(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


def _add_operations(app: FastAPI, health: Health, metrics: Metrics) -> None:
    async def live(_request: Request) -> Response:
        return Response(b'{"live":true}', media_type="application/json")

    async def ready(request: Request) -> Response:
        reason = health.reason()
        if reason:
            raise health.error()
        return Response(b'{"ready":true}', media_type="application/json")

    async def prometheus(_request: Request) -> Response:
        return Response(metrics.text(), media_type="text/plain; version=0.0.4")

    for path, endpoint in (
        ("/healthz", live),
        ("/v2/health/live", live),
        ("/readyz", ready),
        ("/v2/health/ready", ready),
        ("/metrics", prometheus),
    ):
        app.add_route(path, endpoint, methods=["GET"], include_in_schema=False)


def _respond(request: Request, error: ServiceError) -> Response:
    request_id = request.scope.get("freerein.request_id", "")
    request.scope["freerein.code"] = error.code
    return Response(
        problems.document(error, request_id), error.http_status, headers=problems.headers(error, request_id)
    )


async def _answer_service_error(request: Request, error: Exception) -> Response:
    return _respond(request, cast(ServiceError, error))


async def _answer_http_exception(request: Request, error: Exception) -> Response:
    status = cast(HTTPException, error).status_code
    if status == 405:
        response = _respond(request, _MethodNotAllowed("This path answers another method.", hint="See /openapi.json."))
        response.headers.update(cast(HTTPException, error).headers or {})
        return response
    if status == 404:
        return _respond(request, NotFound("There is nothing at this path.", hint="GET /openapi.json lists the paths."))
    return _respond(request, InvalidInput("The request could not be read.", hint="See /openapi.json."))


class _MethodNotAllowed(ServiceError):
    code, http_status, grpc_status = "method_not_allowed", 405, "UNIMPLEMENTED"


def _openapi(app: FastAPI, methods: Sequence[Method]) -> dict[str, Any]:
    document = get_openapi(title=app.title, version=app.version, routes=[])
    schemas: dict[str, Any] = {"Problem": _PROBLEM_SCHEMA}
    for method in methods:
        document["paths"][method.path] = _operation(method, schemas)
    document["components"] = {
        "schemas": schemas,
        "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
    }
    document["security"] = [{}, {"token": []}]
    return document


def _operation(method: Method, schemas: dict[str, Any]) -> dict[str, Any]:
    media_type = _MEDIA_TYPES[method.rest_form]
    summary = (method.request.__doc__ or "").partition("\n")[0]
    operation: dict[str, Any] = {
        "operationId": method.name,
        "summary": summary,
        "responses": {
            "200": {
                "description": (method.response.__doc__ or "").partition("\n")[0],
                "content": {
                    media_type: {"schema": _reference(method.descriptor.output_type, "serialization", schemas)}
                },
            },
            **_PROBLEMS,
        },
    }
    if method.rest_form != "reply":
        operation["responses"]["200"]["content"] = {media_type: {"schema": {"type": "string"}}}
    if method.reads:
        operation["parameters"] = _parameters(method.descriptor.input_type)
        return {"get": operation}
    reference = _reference(method.descriptor.input_type, "validation", schemas)
    operation["requestBody"] = {"required": True, "content": {"application/json": {"schema": reference}}}
    return {"post": operation}


def _reference(message: Descriptor, mode: Any, schemas: dict[str, Any]) -> dict[str, str]:
    """Adds a message's JSON schema, and those it refers to, to the components; returns the reference to it."""
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
            parameters.append({"name": prefix + field.name, "in": "query", "schema": properties[field.name]})
    return parameters
