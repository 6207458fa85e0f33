"""Told to stop under load: no call in flight is lost, and what is refused says so, so that clients call a replica."""

import asyncio
import base64
import json
import signal
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from typing import Any

import grpc
import httpx
import numpy as np
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from freerein import wire
from freerein.clients.channel import Channel
from freerein.clients.services import SegmentationClient
from freerein.errors import Unavailable
from freerein.types.segmentation import SegmentRequest

pytestmark = pytest.mark.e2e
SEGMENT = "/freerein.api.segmentation.v1.SegmentationService/Segment"
CLIENTS = 16
CALLS = 8
HUNDREDTHS = 1  # of a second, that the model takes for a call


def frames() -> Any:
    """A trajectory that asks the model for time."""
    asked = np.zeros((2, 4, 4, 3), np.uint8)
    asked[:, 0, 0, 2] = 0, 1
    asked[0, 0, 0, 1] = HUNDREDTHS
    return asked


async def call_until_closed(call: Callable[[], Awaitable[str]], outcomes: Counter[str], ready: asyncio.Event) -> None:
    """Calls again and again until nobody listens; counts what became of the calls."""
    while (outcome := await call()) != "closed":
        outcomes[outcome] += 1
        ready.set()


async def drained(service: Any, calls: list[Callable[[], Awaitable[str]]]) -> Counter[str]:
    """Sends SIGTERM to a service that many clients call until nobody listens; returns what became of their calls."""
    outcomes: Counter[str] = Counter()
    ready = [asyncio.Event() for _ in calls]
    clients = [
        asyncio.create_task(call_until_closed(call, outcomes, event)) for call, event in zip(calls, ready, strict=True)
    ]
    await asyncio.gather(*(event.wait() for event in ready))
    service.process.send_signal(signal.SIGTERM)
    await asyncio.wait_for(asyncio.gather(*clients), 120)
    assert await asyncio.to_thread(service.process.wait, 60) == 0
    return outcomes


def logged(service: Any) -> Counter[str]:
    """Returns how the calls of the service have ended, as its log at `debug` tells."""
    lines = [json.loads(line) for line in service.log.read_text().splitlines()]
    return Counter(line["code"] for line in lines if line["event"] == "call")


@pytest.mark.fault("F7")
@pytest.mark.fault("G7")
async def test_no_grpc_call_in_flight_is_lost(start_faulty: Callable[..., Any], repeats: int) -> None:
    message = wire.pack(SegmentRequest(frames=frames())).SerializeToString()
    all_went_on = tries = 0
    while all_went_on < repeats:
        tries += 1
        assert tries < repeats + 10
        service = start_faulty(FREEREIN_LOG_LEVEL="debug").service

        def client(channel: grpc.aio.Channel) -> Callable[[], Awaitable[str]]:
            async def call() -> str:
                try:
                    await channel.unary_unary(SEGMENT)(message, timeout=60)
                except grpc.aio.AioRpcError as error:
                    if "connection refused" in (error.details() or "").lower():
                        return "closed"
                    return "refused" if error.code() is grpc.StatusCode.UNAVAILABLE else repr(error)
                return "answered"

            return call

        options = (("grpc.use_local_subchannel_pool", 1),)
        channels = [grpc.aio.insecure_channel(service.address, options) for _ in range(CLIENTS)]
        outcomes = await drained(service, [client(channel) for channel in channels])
        for channel in channels:
            await channel.close()
        assert set(outcomes) <= {"answered", "refused"}
        all_went_on += outcomes["refused"] >= CLIENTS  # a busy machine may keep some from it
        begun = logged(service)
        assert begun.pop("unavailable", 0) <= outcomes["refused"]
        assert begun == {"ok": outcomes["answered"]}


@pytest.mark.fault("F7")
async def test_no_rest_call_in_flight_is_lost(start_faulty: Callable[..., Any], repeats: int) -> None:
    raw = base64.b64encode(frames().tobytes()).decode()
    body = {"frames": {"datatype": "UINT8", "shape": [2, 4, 4, 3], "raw": raw}}
    for _ in range(repeats):
        service = start_faulty(FREEREIN_LOG_LEVEL="debug").service
        async with httpx.AsyncClient(base_url=service.url, trust_env=False, timeout=60) as http:

            async def call(http: httpx.AsyncClient = http) -> str:
                try:
                    reply = await http.post("/v1/segment", json=body)
                except httpx.ConnectError:
                    return "closed"
                except (httpx.ReadError, httpx.WriteError, httpx.RemoteProtocolError):
                    return "refused"  # an idle connection is closed as a request is sent on it
                return {200: "answered", 503: "refused"}.get(reply.status_code, reply.text)

            outcomes = await drained(service, [call] * CLIENTS)
        assert set(outcomes) <= {"answered", "refused"}
        begun = logged(service)
        assert begun.pop("unavailable", 0) <= outcomes["refused"]
        assert begun == {"ok": outcomes["answered"]}


@pytest.mark.fault("F7")
def test_a_service_that_is_told_to_leave_answers_until_its_delay_is_over(
    start_faulty: Callable[..., Any], wait_until: Callable[..., float]
) -> None:
    faulty = start_faulty(FREEREIN_DRAIN_DELAY_S="600")
    wait_until(lambda: faulty.http.get("/readyz").status_code == 200, 60)
    faulty.service.process.send_signal(signal.SIGTERM)
    wait_until(lambda: faulty.http.get("/readyz").status_code == 503, 60)
    with grpc.insecure_channel(faulty.service.address) as channel:
        health = health_pb2_grpc.HealthStub(channel)
        not_serving = health_pb2.HealthCheckResponse.NOT_SERVING
        wait_until(lambda: health.Check(health_pb2.HealthCheckRequest()).status == not_serving, 60)
        message = wire.pack(SegmentRequest(frames=frames())).SerializeToString()
        assert channel.unary_unary(SEGMENT)(message, timeout=60)
    assert faulty.segment(4, 5).json()["labels"] == [0, 1]
    faulty.service.process.send_signal(signal.SIGTERM)
    assert faulty.service.process.wait(60) == 0


@pytest.mark.fault("F7")
@pytest.mark.fault("K3")
async def test_clients_go_on_at_the_replica_that_remains(start_faulty: Callable[..., Any]) -> None:
    leaving, staying = start_faulty().service, start_faulty().service
    request = SegmentRequest(frames=frames())
    begun = asyncio.Event()

    async def answers() -> int:
        """Calls one replica, and the other one from the first refusal on; returns the number of right answers."""
        right = 0
        async with AsyncExitStack() as stack:
            addresses = [leaving.address, staying.address]
            replicas = [await stack.enter_async_context(SegmentationClient(Channel(each))) for each in addresses]
            while right < CALLS:
                try:
                    reply = await replicas[0].segment(request)
                except Unavailable:
                    replicas.pop(0)
                else:
                    assert list(reply.labels) == [0, 1]
                    right += 1
                    begun.set()
        return right

    clients = [asyncio.create_task(answers()) for _ in range(CLIENTS)]
    await begun.wait()
    leaving.process.send_signal(signal.SIGTERM)
    assert await asyncio.gather(*clients) == [CALLS] * CLIENTS
    assert await asyncio.to_thread(leaving.process.wait, 60) == 0
