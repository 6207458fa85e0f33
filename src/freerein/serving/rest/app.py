"""The Starlette app of a service: one route per method, health, metrics, and errors as problem documents."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack, aclosing
from dataclasses import replace
from typing import Any, cast

import orjson
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route, WebSocketRoute

from freerein import wire
from freerein.errors import InvalidInput, must_be
from freerein.serving.call_recorder import OTHER, CallRecorder, machine_errors
from freerein.serving.error_replies import MethodNotAllowed
from freerein.serving.health import Health
from freerein.serving.limits import Limits, Slots
from freerein.serving.memory import Memory, encode
from freerein.serving.methods import Method
from freerein.serving.metrics import Metrics
from freerein.serving.rest import body, pictures, tensor_lists
from freerein.serving.rest.client_presence import HeldResponse, while_connected
from freerein.serving.rest.docs_page import docs_routes
from freerein.serving.rest.field_names import unknown_path
from freerein.serving.rest.middleware import SHARE, RequestMiddleware
from freerein.serving.rest.openapi import MEDIA_TYPES, api_title, openapi_document
from freerein.serving.rest.origin_policy import OriginPolicy
from freerein.serving.rest.reply_parts import PartsResponse, json_parts
from freerein.serving.rest.session import Session
from freerein.serving.rest.web_page import WebPage
from freerein.serving.rest.websocket import ABOUT, PATH, OpenSession, WebSocketEndpoint

_Endpoint = Callable[[Request], Awaitable[Response]]
_SILENCE = object()
_UNBUFFERED = {"cache-control": "no-cache", "x-accel-buffering": "no"}  # by nginx, which else keeps events for long


def make_app(
    name: str,
    methods: Sequence[Method],
    *,
    health: Health,
    metrics: Metrics,
    limits: Limits,
    memory: Memory | None = None,
    token: str = "",
    origins: Sequence[str] = (),
    is_local: bool = False,
    open_websocket: OpenSession | None = None,
    configs: Callable[[], Mapping[str, Any]] = dict,
    page: WebPage | None = None,
) -> Starlette:
    """Returns the REST API of a service; methods without a REST form are served over gRPC only.

    An empty `token` allows every call. Web pages of the `origins` may call it, too. With `is_local`, it must be called
    by a name of loopback. With `open_websocket` it has a WebSocket. Without `memory`, it has all of the limits' alone.
    `configs` returns JSON schemas of the field `config`, by message of a request. With a `page`, browsers may sign in.
    """
    origin_policy = OriginPolicy(origins, is_local)
    served = [method for method in methods if method.rest_form != "none"]

    def document() -> dict[str, Any]:
        about_websocket = ABOUT if open_websocket else ""
        return openapi_document(
            methods, service=name, has_token=bool(token), websocket=about_websocket, configs=configs()
        )

    routes = [
        *_method_routes(served, limits),
        *_health_and_metrics_routes(health, metrics, limits),
        *docs_routes(document, title=api_title(name)),
    ]
    if open_websocket is not None:
        endpoint = WebSocketEndpoint(
            open_websocket, health=health, metrics=metrics, limits=limits, token=token, origin_policy=origin_policy
        )
        routes += [WebSocketRoute(PATH, endpoint.serve), WebSocketRoute("/{elsewhere:path}", endpoint.refuse_path)]
    session = Session(token) if page else None
    pages = [*page.routes, session.route] if page and session else []
    app = Starlette(routes=[*pages, *routes], exception_handlers={HTTPException: _raise_error})
    app.router.redirect_slashes = False
    app.state.paths = [route.path for route in routes if isinstance(route, Route)]
    app.add_middleware(
        RequestMiddleware,
        limits=limits,
        memory=memory or Memory(limits),
        token=token,
        origin_policy=origin_policy,
        recorders={each.path: CallRecorder(metrics, "rest", each.name, is_stream=each.is_stream) for each in served},
        other=CallRecorder(metrics, "rest", OTHER),
        assets=page.assets if page else None,
        session=session,
    )
    if origins:
        _allow_origins(app, origins)
    return app


def _allow_origins(app: Starlette, origins: Sequence[str]) -> None:
    """Lets web pages call; outermost, since a browser asks for leave without the token."""
    app.add_middleware(
        CORSMiddleware,
        allow_origins=origins,
        allow_methods=["GET", "POST"],
        allow_headers=["authorization", "content-type", "last-event-id", "x-request-id"],
        expose_headers=["retry-after", "x-request-id"],
    )


def _method_routes(methods: Sequence[Method], limits: Limits) -> list[BaseRoute]:
    slots = Slots(limits.streams, "streams may be open")
    return [
        Route(
            method.path,
            _unary(method, limits) if method.rest_form == "reply" else _stream(method, limits, slots),
            methods=["GET" if method.reads else "POST"],
        )
        for method in methods
    ]


def _unary(method: Method, limits: Limits) -> _Endpoint:
    async def answer(request: Request) -> Response:
        if method.reads:
            message = body.read_query(request, method.request)
        else:
            message = await body.read(request, method.request)
        write = _writer(request, method)
        async with while_connected(request, limits.unary_s):
            response = await method.call(message)
        return await write(response)

    return answer


def _writer(request: Request, method: Method) -> Callable[[Any], Awaitable[Response]]:
    """Returns the writer of replies in the form that a request asks for."""

    def json_of(response: Any) -> list[bytes]:
        return json_parts(response, as_lists=bool(form))

    async def json_reply(response: Any) -> Response:
        parts = await encode(response, json_of, request.scope[SHARE])
        return PartsResponse(parts, media_type=MEDIA_TYPES["reply"])

    async def png_reply(response: Any) -> Response:
        png = await encode(response, lambda rendered: pictures.png_of(rendered.frames), request.scope[SHARE])
        return PartsResponse([png], media_type=pictures.MEDIA_TYPE)

    form = "" if method.reads else request.query_params.get(tensor_lists.PARAMETER, "")
    if form not in ("", tensor_lists.LIST):
        hint = "Leave it out for tensors in base64."
        raise must_be(tensor_lists.PARAMETER, f"`{tensor_lists.LIST}`", "another word", hint=hint)
    if pictures.holds_frames(method.descriptor.output_type) and pictures.wants_png(request.headers.get("accept", "")):
        return png_reply
    return json_reply


def _stream(method: Method, limits: Limits, slots: Slots) -> _Endpoint:
    """Answers with server-sent events, or with the bytes of a file.

    The id of an event is its `sequence`; the header `Last-Event-ID` resumes after it. Where there is no event for long,
    a comment keeps the connection open and shows that the service lives.
    """
    is_events = method.rest_form == "events"
    encode_item, silence_s = (_encode_event, limits.keep_alive_s) if is_events else (_encode_part, None)

    async def answer(request: Request) -> Response:
        message = body.read_query(request, method.request)
        if is_events and (last := request.headers.get("last-event-id", "")).isdecimal():
            message = replace(message, from_sequence=int(last[:18]) + 1)
        async with AsyncExitStack() as resources:
            resources.enter_context(slots.hold())
            items = await resources.enter_async_context(aclosing(method.call(message)))
            heard = await resources.enter_async_context(aclosing(_with_silences(items, silence_s)))
            # awaited before the reply begins, so that an unknown id is a 404, not a broken stream
            async with while_connected(request):
                first = await anext(heard, None)
            media_type, headers = MEDIA_TYPES[method.rest_form], _UNBUFFERED if is_events else {}
            if request.method == "HEAD":
                return Response(media_type=media_type, headers=headers)
            content = _encoded(first, heard, encode_item)
            return HeldResponse(content, resources.pop_all(), media_type=media_type, headers=headers)

    return answer


async def _with_silences(items: AsyncIterator[Any], silence_s: float | None) -> AsyncGenerator[Any]:
    """Yields the items, and `_SILENCE` whenever there is none for `silence_s`."""
    item = asyncio.ensure_future(anext(items, None))
    try:
        while True:
            await asyncio.wait({item}, timeout=silence_s)
            if not item.done():
                yield _SILENCE
                continue
            with machine_errors():  # Starlette takes any other error of the system for a client that has left
                found = item.result()
            if found is None:
                return
            yield found
            item = asyncio.ensure_future(anext(items, None))
    finally:
        item.cancel()
        await asyncio.gather(item, return_exceptions=True)  # a generator must not be closed while it runs


async def _encoded(first: Any, rest: AsyncIterator[Any], encode: Callable[[Any], bytes]) -> AsyncIterator[bytes]:
    if first is not None:
        yield encode(first)
        async for item in rest:
            yield encode(item)


def _encode_event(item: Any) -> bytes:
    if item is _SILENCE:
        return b":\n\n"
    return b"id: %d\ndata: %s\n\n" % (item.sequence, orjson.dumps(wire.to_json(item)))


def _encode_part(item: Any) -> bytes:
    return cast(bytes, item.data)


def _health_and_metrics_routes(health: Health, metrics: Metrics, limits: Limits) -> list[BaseRoute]:
    async def live(_request: Request) -> Response:
        return Response(b'{"live":true}', media_type="application/json")

    async def ready(_request: Request) -> Response:
        if health.reason():
            raise health.error()
        return Response(b'{"ready":true}', media_type="application/json")

    async def prometheus(request: Request) -> Response:
        async with while_connected(request, limits.unary_s):  # the disk may hang
            text = await metrics.read()
        return Response(text, media_type="text/plain; version=0.0.4")

    return [
        Route("/healthz", live),
        Route("/v2/health/live", live),
        Route("/readyz", ready),
        Route("/v2/health/ready", ready),
        Route("/metrics", prometheus),
    ]


async def _raise_error(request: Request, error: Exception) -> Response:
    """Raises Starlette's error as ours."""
    http_error = cast(HTTPException, error)
    if http_error.status_code == 405:
        refused = MethodNotAllowed("The path has another method.", hint="See /openapi.json.")
        refused.allow = (http_error.headers or {}).get("Allow", "")
        raise refused
    if http_error.status_code == 404:
        raise unknown_path(request.scope["path"], request.app.state.paths)
    raise InvalidInput("The request could not be read.", hint="See /openapi.json.")
