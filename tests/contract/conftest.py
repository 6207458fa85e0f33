"""The three transports of a service: its core in process, its REST app in process, its gRPC server on a port."""

import json
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import grpc
import httpx
import pytest
from starlette.applications import Starlette

from freerein import errors, wire
from freerein.clients.grpc_errors import service_error
from freerein.clients.stream_responses import stream_responses
from freerein.errors import ServiceError
from freerein.serving.grpc_server import GrpcServer
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service
from freerein.serving.limits import Limits
from freerein.serving.methods import Method
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app
from freerein.serving.rest.schemas import schema_of
from freerein.serving.rest.wording import with_paths


class Transport(Protocol):
    """Sends a request and returns all responses, or raises the `ServiceError` of a refusal.

    A bidirectional stream, which REST does not have, is sent a list of messages.
    """

    async def __call__(self, method: Method, request: object) -> list[Any]: ...


@dataclass(frozen=True)
class Transports:
    methods: tuple[Method, ...]
    core: Transport
    rest: Transport
    grpc: Transport
    app: Starlette
    document: dict[str, Any]
    channel: grpc.aio.Channel

    @property
    def all(self) -> tuple[Transport, ...]:
        return self.core, self.rest, self.grpc

    async def outcome(self, name: str, *requests: object) -> Any:
        """Returns what a request, or one for each transport, comes to over all: replies without timing, or an error."""
        each = requests * 3 if len(requests) == 1 else requests
        found = [await _outcome(*pair, self.method(name)) for pair in zip(self.all, each, strict=True)]
        assert found[0] == found[1] == found[2]
        return found[0]

    def method(self, name: str) -> Method:
        return next(method for method in self.methods if method.name == name)


async def _outcome(transport: Transport, request: object, method: Method) -> object:
    try:
        responses = await transport(method, request)
    except ServiceError as error:
        return error.code, error.field, with_paths(error.detail), with_paths(error.hint)
    return [_untimed(wire.to_json(response)) for response in responses]


def _untimed(value: Any) -> Any:
    """Returns a JSON value without the durations in it."""
    if isinstance(value, list):
        return [_untimed(each) for each in value]
    return (
        {name: _untimed(each) for name, each in value.items() if name != "timing"} if isinstance(value, dict) else value
    )


Build = Callable[[Path, Health], Service]
Connect = Callable[[Build, Path], AbstractAsyncContextManager[Transports]]


@pytest.fixture(scope="session")
def connect() -> Connect:
    """A context manager that builds and starts a service in a data directory, and opens its transports."""
    return _connect


@asynccontextmanager
async def _connect(build: Build, data_dir: Path) -> AsyncIterator[Transports]:
    async with AsyncExitStack() as stack:
        health, metrics, limits = Health(), Metrics(), Limits()
        service = build(data_dir, health)
        await service.start()
        stack.push_async_callback(service.close)
        stack.callback(health.drain)
        app = make_app(service.name, service.methods, health=health, metrics=metrics, limits=limits)
        asgi = httpx.ASGITransport(app, raise_app_exceptions=False)
        client = await stack.enter_async_context(httpx.AsyncClient(transport=asgi, base_url="http://service"))
        grpc_server = GrpcServer(service.methods, health=health, metrics=metrics, limits=limits)
        port = grpc_server.server.add_insecure_port("127.0.0.1:0")
        await grpc_server.server.start()
        stack.push_async_callback(grpc_server.server.stop, None)
        channel = await stack.enter_async_context(grpc.aio.insecure_channel(f"127.0.0.1:{port}"))
        document = (await client.get("/openapi.json")).json()
        yield Transports(service.methods, _call_core, _Rest(client), _Grpc(channel), app, document, channel)


async def _each(messages: Iterable[Any]) -> AsyncIterator[Any]:
    for message in messages:
        yield message


async def _call_core(method: Method, request: Any) -> list[Any]:
    if method.descriptor.client_streaming:
        messages = (wire.unpack(wire.pack(each), method.request) for each in request)
        return [response async for response in method.call(_each(messages))]
    request = wire.unpack(wire.pack(request), method.request)  # which checks the bounds of the contract
    if method.descriptor.server_streaming:
        return [response async for response in method.call(request)]
    return [await method.call(request)]


class _Rest:
    def __init__(self, client: httpx.AsyncClient) -> None:
        self._client = client

    async def __call__(self, method: Method, request: object) -> list[Any]:
        values = wire.to_json(request)
        if method.reads:
            reply = await self._client.get(method.path, params=dict(_flat(values)))
        else:
            reply = await self._client.post(method.path, json=values)
        if reply.status_code != 200:
            raise _error(reply)
        if method.rest_form == "file":
            return [method.response(reply.content)]
        if method.rest_form == "reply":
            return [_dataclass(reply.json(), method)]
        lines = [line for line in reply.text.splitlines() if line.startswith("data: ")]
        return [_dataclass(json.loads(line.removeprefix("data: ")), method) for line in lines]


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    pairs: list[tuple[str, Any]] = []
    for name, value in values.items():
        pairs += _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else [(prefix + name, value)]
    return pairs


def _dataclass(values: object, method: Method) -> Any:
    return wire.unpack(schema_of(method.descriptor.output_type).model_validate(values, strict=True), method.response)


def _error(reply: httpx.Response) -> ServiceError:
    assert reply.headers["content-type"] == "application/problem+json"
    assert len(reply.content) <= 4096
    problem = reply.json()
    cls = errors.by_code(problem["code"])
    assert (problem["status"], cls.http_status) == (reply.status_code, reply.status_code)
    assert problem["request_id"] == reply.headers["x-request-id"]
    return cls(problem["detail"], field=problem["field"], hint=problem["hint"])


class _Grpc:
    def __init__(self, channel: grpc.aio.Channel) -> None:
        self._channel = channel

    async def __call__(self, method: Method, request: Any) -> list[Any]:
        path = f"/{method.descriptor.containing_service.full_name}/{method.name}"
        codec = {
            "request_serializer": lambda message: message.SerializeToString(),
            "response_deserializer": wire.message_type(method.response).FromString,
        }
        try:
            if method.descriptor.client_streaming:
                stream = self._channel.stream_stream(path, **codec)(_each(map(wire.pack, request)))
                return [wire.unpack(message, method.response) async for message in stream_responses(stream)]
            if method.descriptor.server_streaming:
                call = self._channel.unary_stream(path, **codec)(wire.pack(request))
                return [wire.unpack(message, method.response) async for message in call]
            return [wire.unpack(await self._channel.unary_unary(path, **codec)(wire.pack(request)), method.response)]
        except grpc.aio.AioRpcError as error:
            raise service_error(error, call=method.name) from None
