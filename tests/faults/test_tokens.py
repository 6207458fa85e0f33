"""No door opens without the token but those of the health checks, and none of the others was forgotten."""

import asyncio
import itertools
import time
from collections.abc import Callable
from typing import Any

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
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app

pytestmark = [pytest.mark.e2e, pytest.mark.fault("C13")]
TOKEN = "correct-horse-battery"
OPEN = {"/healthz", "/readyz", "/v2/health/live", "/v2/health/ready"}
LEARNING = learning_pb2.DESCRIPTOR.services_by_name
LEARNED = (LEARNING["FitService"], LEARNING["ModelService"])
SERVICES = {
    "segmentation": (segmentation_pb2.DESCRIPTOR.services_by_name["SegmentationService"], *LEARNED),
    "imitation": (imitation_pb2.DESCRIPTOR.services_by_name["ImitationService"], *LEARNED),
    "reward": (reward_pb2.DESCRIPTOR.services_by_name["RewardService"], *LEARNED),
    "sim": (sim_pb2.DESCRIPTOR.services_by_name["SimService"],),
    "orchestrator": (orchestrator_pb2.DESCRIPTOR.services_by_name["OrchestratorService"],),
}
MODULES = {
    "segmentation": "faulty_service.py",
    "imitation": "faulty_policy.py",
    "reward": "faulty_reward.py",
    "sim": "freerein_sim",
    "orchestrator": "freerein_orchestrator",
}
REFLECTION = "grpc.reflection.v1{}.ServerReflection"
WRONG = [None, "Bearer", "Bearer wrong", f"Bearer {TOKEN}x", f"Bearer {TOKEN[:-1]}", f"Basic {TOKEN}", TOKEN]


class EveryMethod:
    """A core that has whatever method it is asked for."""

    def __getattr__(self, name: str) -> object:
        return name


def routes(name: str) -> list[tuple[str, str]]:
    """Returns every (method, path) that a service's REST app knows, and some that it does not."""
    methods = [method for service in SERVICES[name] for method in methods_of(service, EveryMethod())]
    app = make_app("x", methods, health=Health(), metrics=Metrics(), limits=Limits())
    known = [(verb, route.path) for route in app.routes for verb in route.methods]  # type: ignore[attr-defined]
    return sorted({*known, ("GET", "/"), ("POST", "/v1/unknown"), ("GET", "/healthz/"), ("GET", "/healthz/x")})


@pytest.fixture(scope="module", params=SERVICES)
def named(request: pytest.FixtureRequest, start_faulty: Callable[..., Any]) -> tuple[str, Any]:
    """Each service, as a process that asks for the token."""
    return request.param, start_faulty(script=MODULES[request.param], FREEREIN_TOKEN=TOKEN)


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty(FREEREIN_TOKEN=TOKEN)


def test_the_routes_are_those_that_are_meant() -> None:
    paths = {path for name in SERVICES for _, path in routes(name)}
    assert paths >= OPEN | {"/metrics", "/openapi.json", "/docs", "/v1/segment", "/v1/watch-fit", "/v1/activate-model"}
    assert paths >= {"/v1/step", "/v1/act", "/v1/reward", "/v1/start-run", "/v1/watch-run", "/v1/get-artifact"}


def test_every_route_without_the_token_is_closed_unless_it_tells_health(named: tuple[str, Any], refusal: Any) -> None:
    name, faulty = named
    until_ready(faulty)
    with httpx.Client(base_url=faulty.service.url, params={"token": TOKEN}, timeout=30, trust_env=False) as client:
        for (verb, path), authorization in itertools.product(routes(name), WRONG):
            headers = {"authorization": authorization} if authorization is not None else {}
            reply = client.request(verb, path, headers=headers)
            if path in OPEN:
                assert reply.status_code == 200, path
            elif verb == "HEAD":
                assert reply.status_code == 401, path
            else:
                assert refusal(reply, 401), path
                assert reply.headers["www-authenticate"] == "Bearer"


def until_ready(faulty: Any) -> None:
    while faulty.http.get("/readyz").status_code != 200:
        time.sleep(0.02)


async def test_every_rpc_without_the_token_is_closed(named: tuple[str, Any]) -> None:
    name, faulty = named
    rpcs = [f"/{service.full_name}/{method.name}" for service in SERVICES[name] for method in service.methods]
    rpcs += [f"/{REFLECTION.format(version)}/ServerReflectionInfo" for version in ("alpha", "")]
    async with grpc.aio.insecure_channel(faulty.service.address) as channel:
        for rpc, authorization in itertools.product(rpcs, WRONG):
            metadata = (("authorization", authorization),) if authorization is not None else ()
            call = channel.stream_stream(rpc)(iter(()), metadata=metadata, timeout=10)
            with pytest.raises(grpc.aio.AioRpcError) as error:
                await call.read()
            assert error.value.code() is grpc.StatusCode.UNAUTHENTICATED, rpc


async def test_there_is_no_rpc_beyond_those_tested(named: tuple[str, Any]) -> None:
    name, faulty = named
    metadata = (("authorization", f"Bearer {TOKEN}"),)
    async with grpc.aio.insecure_channel(faulty.service.address) as channel:
        stub = reflection_pb2_grpc.ServerReflectionStub(channel)
        request = reflection_pb2.ServerReflectionRequest(list_services="")
        reply = await stub.ServerReflectionInfo(iter([request]), metadata=metadata).read()
    names = {service.name for service in reply.list_services_response.service}
    assert names == {service.full_name for service in SERVICES[name]} | {
        "grpc.health.v1.Health",
        REFLECTION.format("alpha"),
    }


async def test_health_needs_no_token_and_the_token_opens_all(faulty: Any) -> None:
    async with grpc.aio.insecure_channel(faulty.service.address) as channel:
        health = health_pb2_grpc.HealthStub(channel)
        async with asyncio.timeout(10):
            async for told in health.Watch(health_pb2.HealthCheckRequest()):
                if told.status == health_pb2.HealthCheckResponse.SERVING:
                    break
    assert faulty.segment(0, 1).json()["labels"] == [0, 1]
    assert faulty.http.get("/openapi.json").status_code == 200


def test_the_token_is_asked_for_before_the_body_is_read(faulty: Any) -> None:
    head = b"POST /v1/segment HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\ncontent-length: 1000000\r\n"
    with faulty.connect() as connection:
        connection.sendall(head + b"\r\n{")
        assert connection.recv(4096).startswith(b"HTTP/1.1 401")


def test_the_token_is_never_logged(faulty: Any) -> None:
    faulty.segment(0, 1)
    log = faulty.service.log.read_text()
    assert "/v1/segment" in log
    assert TOKEN not in log
