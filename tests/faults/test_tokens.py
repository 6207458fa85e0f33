"""Every REST route and every RPC of every service needs the token, except health checks and the page of the API."""

import asyncio
import itertools
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import grpc
import httpx
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection_pb2, reflection_pb2_grpc

from freerein.api.imitation.v1 import imitation_pb2
from freerein.api.learning.v1 import learning_pb2
from freerein.api.orchestrator.v1 import orchestrator_pb2
from freerein.api.reward.v1 import reward_pb2
from freerein.api.segmentation.v1 import segmentation_pb2
from freerein.api.sim.v1 import sim_pb2
from freerein.serving.grpc_server import GrpcServer
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app

pytestmark = [pytest.mark.e2e, pytest.mark.fault("C13")]
TOKEN = "correct-horse-battery"
HEALTH = {"/healthz", "/readyz", "/v2/health/live", "/v2/health/ready"}
PAGE = {"/", "/docs", "/docs/favicon.png", "/docs/swagger-ui-bundle.js", "/docs/swagger-ui.css", "/openapi.json"}
OPEN = HEALTH | PAGE
LEARNING = learning_pb2.DESCRIPTOR.services_by_name
LEARNED = (LEARNING["FitService"], LEARNING["ModelService"])
SERVICES = {
    "segmentation": (segmentation_pb2.DESCRIPTOR.services_by_name["SegmentationService"], *LEARNED),
    "imitation": (imitation_pb2.DESCRIPTOR.services_by_name["ImitationService"], *LEARNED),
    "reward": (reward_pb2.DESCRIPTOR.services_by_name["RewardService"], *LEARNED),
    "sim": (sim_pb2.DESCRIPTOR.services_by_name["SimService"],),
    "orchestrator": (orchestrator_pb2.DESCRIPTOR.services_by_name["OrchestratorService"],),
}
REFLECTION = "grpc.reflection.v1{}.ServerReflection"
T = TypeVar("T")
WRONG = [None, "Bearer", "Bearer wrong", f"Bearer {TOKEN}x", f"Bearer {TOKEN[:-1]}", f"Basic {TOKEN}", TOKEN]


def asked(whatever: list[T]) -> Iterator[tuple[T, str | None]]:
    """Yields each with another wrong token than the one before; `freerein/test_auth.py` has what opens and what not."""
    return zip(whatever, itertools.cycle(WRONG), strict=False)


class EveryMethod:
    """A core that has every method."""

    def __getattr__(self, name: str) -> object:
        return name


@dataclass(frozen=True)
class Served:
    """A service's REST app in process and its gRPC server on a port, both with the token.

    Attributes:
        routes: Every (method, path) of the REST app, and some that it does not have.
        rpcs: Every RPC.
        services: Full names of the gRPC services.
    """

    rest: httpx.AsyncClient
    channel: grpc.aio.Channel
    routes: list[tuple[str, str]]
    rpcs: list[str]
    services: set[str]


@pytest.fixture(params=SERVICES)
async def served(request: pytest.FixtureRequest) -> AsyncIterator[Served]:
    """Each service without its core: no call without the token reaches one."""
    services = SERVICES[request.param]
    methods = [method for service in services for method in methods_of(service, EveryMethod())]
    health, metrics, limits = Health(), Metrics(), Limits()
    app = make_app("x", methods, health=health, metrics=metrics, limits=limits, token=TOKEN)
    grpc_server = GrpcServer(methods, health=health, metrics=metrics, limits=limits, token=TOKEN)
    port = grpc_server.server.add_insecure_port("127.0.0.1:0")
    await grpc_server.server.start()
    known = {(verb, route.path) for route in app.routes for verb in route.methods}  # type: ignore[attr-defined]
    unknown = {("GET", "/"), ("POST", "/v1/unknown"), ("GET", "/healthz/"), ("GET", "/healthz/x")}
    rpcs = [f"/{service.full_name}/{method.name}" for service in services for method in service.methods]
    rpcs += [f"/{REFLECTION.format(version)}/ServerReflectionInfo" for version in ("alpha", "")]
    transport = httpx.ASGITransport(app)
    async with (
        httpx.AsyncClient(transport=transport, base_url="http://x", params={"token": TOKEN}) as rest,
        grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel,
    ):
        yield Served(rest, channel, sorted(known | unknown), rpcs, {service.full_name for service in services})
    await grpc_server.server.stop(None)


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty(FREEREIN_TOKEN=TOKEN)


async def test_every_route_but_health_and_the_page_is_refused_without_the_token(served: Served, refusal: Any) -> None:
    paths = {path for _, path in served.routes}
    assert paths >= OPEN | {"/metrics"}
    assert any(path.startswith("/v1/") and path != "/v1/unknown" for path in paths)
    for (verb, path), authorization in asked(served.routes):
        headers = {"authorization": authorization} if authorization is not None else {}
        reply = await served.rest.request(verb, path, headers=headers)
        if path in OPEN:
            assert reply.status_code == (307 if path == "/" else 200), path
        elif verb == "HEAD":
            assert reply.status_code == 401, path
        else:
            assert refusal(reply, 401), path
            assert reply.headers["www-authenticate"] == "Bearer"


async def test_every_rpc_is_refused_without_the_token(served: Served) -> None:
    for rpc, authorization in asked(served.rpcs):
        metadata = (("authorization", authorization),) if authorization is not None else ()
        call = served.channel.stream_stream(rpc)(iter(()), metadata=metadata, timeout=60)
        with pytest.raises(grpc.aio.AioRpcError) as error:
            await call.read()
        assert error.value.code() is grpc.StatusCode.UNAUTHENTICATED, rpc


async def test_reflection_lists_no_other_service(served: Served) -> None:
    metadata = (("authorization", f"Bearer {TOKEN}"),)
    stub = reflection_pb2_grpc.ServerReflectionStub(served.channel)
    request = reflection_pb2.ServerReflectionRequest(list_services="")
    reply = await stub.ServerReflectionInfo(iter([request]), metadata=metadata).read()
    names = {service.name for service in reply.list_services_response.service}
    assert names == served.services | {"grpc.health.v1.Health", REFLECTION.format("alpha")}


async def test_health_needs_no_token_and_the_token_opens_all(faulty: Any) -> None:
    async with grpc.aio.insecure_channel(faulty.service.address) as channel:
        health = health_pb2_grpc.HealthStub(channel)
        async with asyncio.timeout(300):
            async for told in health.Watch(health_pb2.HealthCheckRequest()):
                if told.status == health_pb2.HealthCheckResponse.SERVING:
                    break
    assert faulty.segment(0, 1).json()["labels"] == [0, 1]
    assert faulty.http.get("/metrics").status_code == 200


def test_the_token_is_asked_for_before_the_body_is_read(faulty: Any) -> None:
    head = b"POST /v1/segment HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\ncontent-length: 1000000\r\n"
    with faulty.connect() as connection:
        connection.sendall(head + b"\r\n{")
        assert connection.recv(4096).startswith(b"HTTP/1.1 401")


def test_the_token_is_never_logged(faulty: Any) -> None:
    faulty.segment(0, 1, fault="nan")
    log = faulty.service.log.read_text()
    assert '"Segment"' in log
    assert TOKEN not in log
