"""More than the model can do, and callers that go away: a bounded queue, quick refusals, and no work for nobody."""

import asyncio
import contextlib
import json
import math
import random
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import grpc
import httpx
import numpy as np
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from freerein import wire
from freerein.types.segmentation import SegmentRequest, SegmentResponse

pytestmark = pytest.mark.e2e
QUEUE = 4
PATH = "/freerein.api.segmentation.v1.SegmentationService/Segment"


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty(FREEREIN_QUEUE=str(QUEUE))


@dataclass(frozen=True)
class Call:
    """What came of one call: its status, when it began and how long it took, and whether the answer was right."""

    status: int
    begun_s: float
    took_s: float
    retry_after: str
    right: bool


async def open_loop(faulty: Any, *, calls: int, per_s: float, hundredths: int) -> list[Call]:
    """Sends calls at a steady rate, whether or not the ones before have been answered."""
    limits = httpx.Limits(max_connections=calls, max_keepalive_connections=calls)
    async with httpx.AsyncClient(base_url=faulty.service.url, limits=limits, timeout=30, trust_env=False) as client:
        for _ in range(3):
            await client.get("/healthz")

        async def call(number: int) -> Call:
            body = json.dumps(faulty.trajectory([number, number + 1], hundredths=hundredths))
            await asyncio.sleep(number / per_s)
            begun = time.perf_counter()
            reply = await client.post("/v1/segment", content=body, headers={"content-type": "application/json"})
            took = time.perf_counter() - begun
            right = reply.status_code == 200 and reply.json()["labels"] == [number % 2, (number + 1) % 2]
            return Call(reply.status_code, begun, took, reply.headers.get("retry-after", ""), right)

        return list(await asyncio.gather(*(call(number) for number in range(calls))))


@pytest.mark.fault("C11")
@pytest.mark.fault("G2")
async def test_four_times_too_much_is_refused_quickly_and_what_is_accepted_is_right(faulty: Any) -> None:
    capacity_per_s, hundredths = 20.0, 5
    refused_s = accepted_s = math.inf
    longest_s = (QUEUE + QUEUE + 1) * hundredths / 100  # the batch in work, the batch that waits, and its own turn
    for _ in range(3):  # a busy machine only adds to the seconds
        calls = await open_loop(faulty, calls=160, per_s=4 * capacity_per_s, hundredths=hundredths)
        accepted = [call for call in calls if call.status == 200]
        refused = [call for call in calls if call.status == 429]
        assert len(accepted) + len(refused) == len(calls)
        assert len(accepted) >= 0.5 * capacity_per_s * (calls[-1].begun_s - calls[0].begun_s)
        assert len(refused) > len(calls) / 3
        assert all(call.right for call in accepted)
        assert all(call.retry_after == "1" for call in refused)
        refused_s = min(refused_s, np.median([call.took_s for call in refused]))
        accepted_s = min(accepted_s, np.percentile([call.took_s for call in accepted], 99))
        if refused_s < 0.05 and accepted_s < 2 * longest_s:
            break
    assert refused_s < 0.05
    assert accepted_s < 2 * longest_s


@pytest.mark.fault("C11")
@pytest.mark.fault("G2")
async def test_after_the_overload_all_is_as_before(faulty: Any) -> None:
    await open_loop(faulty, calls=40, per_s=400, hundredths=5)
    begun = time.monotonic()
    assert faulty.segment(2, 3).status_code == 200
    assert time.monotonic() - begun < 1.0
    assert faulty.metric("freerein_queued_items") == 0


@pytest.mark.fault("C11")
async def test_grpc_refuses_with_resource_exhausted_and_when_to_come_back(faulty: Any) -> None:
    frames = np.zeros((2, 4, 4, 3), np.uint8)
    frames[0, 0, 0, 1] = 30
    request = wire.pack(SegmentRequest(frames=frames)).SerializeToString()
    async with grpc.aio.insecure_channel(faulty.service.address) as channel:
        calls = [channel.unary_unary(PATH)(request, timeout=10) for _ in range(QUEUE + 8)]
        results = await asyncio.gather(*calls, return_exceptions=True)
    refused = [result for result in results if isinstance(result, grpc.aio.AioRpcError)]
    assert len(results) - len(refused) >= QUEUE
    assert len(refused) >= 1
    for error in refused:
        assert error.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
        status = await status_of(error)
        retry = error_details_pb2.RetryInfo()
        assert any(detail.Unpack(retry) for detail in status.details)
        assert retry.retry_delay.seconds == 1
    answers = [wire.message_type(SegmentResponse).FromString(r) for r in results if isinstance(r, bytes)]
    assert all(list(answer.labels) == [0, 0] for answer in answers)


async def status_of(error: grpc.aio.AioRpcError) -> Any:
    class _Call:
        def trailing_metadata(self) -> Any:
            return error.trailing_metadata()

        def code(self) -> Any:
            return error.code()

        def details(self) -> Any:
            return error.details()

    return rpc_status.from_call(_Call())


# --- callers that go away


def send_and_leave(faulty: Any, body: bytes, *, sent: int) -> socket.socket:
    """Sends the first bytes of a request to segment, and returns the connection, to be closed by the caller."""
    head = (
        f"POST /v1/segment HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\ncontent-length: {len(body)}\r\n\r\n"
    ).encode()
    connection: socket.socket = faulty.connect()
    connection.sendall((head + body)[:sent])
    return connection


def wait_until(condition: Callable[[], bool], within_s: float) -> float:
    begun = time.monotonic()
    while not condition():
        assert time.monotonic() - begun < within_s, "it never came true"
    return time.monotonic() - begun


def wait_for_the_model_to_begin(faulty: Any, protocol: str, in_flight: int) -> None:
    """Returns when so many calls are in flight and none of them waits: the first then has the model."""
    in_a_row = 0
    while in_a_row < 5:
        begun = faulty.metric(f'freerein_calls_in_flight{{protocol="{protocol}"}}') == in_flight
        in_a_row = in_a_row + 1 if begun and faulty.metric("freerein_queued_items") == 0 else 0


@pytest.mark.fault("C12")
def test_callers_that_go_away_free_their_places_and_never_reach_the_model(faulty: Any, least_of_three: Any) -> None:
    body = json.dumps(faulty.trajectory([0, 1])).encode()
    slow = json.dumps(faulty.trajectory([0, 1], hundredths=100)).encode()

    def seconds_until_free() -> float:
        batches, cancelled = faulty.metric("freerein_batch_size_sum"), faulty.metric(CANCELLED)
        with contextlib.closing(send_and_leave(faulty, slow, sent=10**6)) as holder:
            wait_for_the_model_to_begin(faulty, "rest", 2)
            waiting = [send_and_leave(faulty, body, sent=10**6) for _ in range(QUEUE)]
            wait_until(lambda: faulty.metric("freerein_queued_items") == QUEUE, 1.0)
            for connection in waiting:
                connection.close()
            seconds = wait_until(lambda: faulty.metric("freerein_queued_items") == 0, 0.5)
            assert holder.recv(65536).startswith(b"HTTP/1.1 200")
        assert faulty.metric(CANCELLED) == cancelled + QUEUE
        assert faulty.metric("freerein_batch_size_sum") == batches + 1
        return seconds

    assert least_of_three(seconds_until_free, below=0.1) < 0.1


CANCELLED = 'freerein_cancelled_total{protocol="rest"}'
IN_FLIGHT = 'freerein_calls_in_flight{protocol="rest"}'  # of which one is the reading of the metrics


@pytest.mark.fault("C12")
def test_callers_that_go_away_at_any_moment_leave_nothing_behind(faulty: Any, fuzz: bool) -> None:
    rng = random.Random(12)
    body = json.dumps(faulty.trajectory([0, 1], hundredths=1)).encode()
    for _ in range(1_000 if fuzz else 150):
        connection = send_and_leave(faulty, body, sent=rng.randrange(1, len(body) + 400))
        if rng.random() < 0.5:
            connection.setblocking(False)
        else:
            connection.settimeout(rng.random() * 0.02 + 0.001)
        with contextlib.suppress(BlockingIOError, TimeoutError):
            connection.recv(1)
        connection.close()
    wait_until(lambda: faulty.metric(IN_FLIGHT) == 1, 2.0)
    assert faulty.metric("freerein_queued_items") == 0
    assert faulty.segment(6, 7).json()["labels"] == [0, 1]


@pytest.mark.fault("C12")
async def test_grpc_calls_that_are_cancelled_never_reach_the_model(faulty: Any) -> None:
    batches = faulty.metric("freerein_batch_size_sum")
    frames = np.zeros((1, 4, 4, 3), np.uint8)
    quick = wire.pack(SegmentRequest(frames=frames)).SerializeToString()
    frames[0, 0, 0, 1] = 50
    slow = wire.pack(SegmentRequest(frames=frames)).SerializeToString()
    async with grpc.aio.insecure_channel(faulty.service.address) as channel:
        holder = channel.unary_unary(PATH)(slow, timeout=10)
        await asyncio.to_thread(wait_for_the_model_to_begin, faulty, "grpc", 1)
        waiting = [channel.unary_unary(PATH)(quick, timeout=10) for _ in range(QUEUE)]
        await asyncio.to_thread(wait_until, lambda: faulty.metric("freerein_queued_items") == QUEUE, 1.0)
        for call in waiting:
            call.cancel()
        await asyncio.to_thread(wait_until, lambda: faulty.metric("freerein_queued_items") == 0, 1.0)
        await holder
    assert faulty.metric("freerein_batch_size_sum") == batches + 1
    assert faulty.metric('freerein_calls_in_flight{protocol="grpc"}') == 0
    assert faulty.metric('freerein_cancelled_total{protocol="grpc"}') >= QUEUE
