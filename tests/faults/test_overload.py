"""More than the model can do, and callers that go away: a bounded queue, quick refusals, and no work for nobody."""

import asyncio
import contextlib
import io
import json
import random
import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
import httpx
import numpy as np
import PIL.Image
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from freerein import wire
from freerein.types.segmentation import SegmentRequest, SegmentResponse

pytestmark = pytest.mark.e2e
QUEUE = 4
HELD = 6  # the fault of that name
PATH = "/freerein.api.segmentation.v1.SegmentationService/Segment"


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty(FREEREIN_QUEUE=str(QUEUE))


@pytest.mark.fault("C11")
@pytest.mark.fault("G2")
def test_four_times_too_much_is_refused_quickly_and_what_is_accepted_is_right_and_all_is_then_as_before(
    faulty: Any, refusal: Any, wait_until: Any
) -> None:
    hundredths, refused_s, accepted_s, next_s = 20, [], [], []
    longest_s = QUEUE * hundredths / 100  # that a call waits in a full queue, its own time included
    with ThreadPoolExecutor(QUEUE + 1) as pool:
        for _ in range(10):  # a busy machine only adds to the seconds
            pool.submit(faulty.segment, fault="held")
            with faulty.hold():
                accepted = [pool.submit(faulty.segment, n, n + 1, hundredths=hundredths) for n in range(QUEUE)]
                wait_until(lambda: faulty.metric("freerein_queued_items") == QUEUE, 60)
                for _ in range(3 * QUEUE):
                    begun = time.perf_counter()
                    reply = faulty.segment(0, 1)
                    refused_s.append(time.perf_counter() - begun)
                    refusal(reply, 429)
                    assert reply.headers["retry-after"] == "1"
            begun = time.perf_counter()
            for n, call in enumerate(accepted):
                assert call.result().json()["labels"] == [n % 2, (n + 1) % 2]
            accepted_s.append(time.perf_counter() - begun)
            assert faulty.metric("freerein_queued_items") == 0
            begun = time.perf_counter()
            assert faulty.segment(2, 3).status_code == 200
            next_s.append(time.perf_counter() - begun)
            if min(refused_s) < 0.05 and min(accepted_s) < 2 * longest_s and min(next_s) < 1.0:
                break
    assert min(refused_s) < 0.05
    assert min(accepted_s) < 2 * longest_s
    assert min(next_s) < 1.0


@pytest.mark.fault("C11")
async def test_grpc_refuses_with_resource_exhausted_and_when_to_come_back(faulty: Any, wait_until: Any) -> None:
    frames = np.zeros((2, 4, 4, 3), np.uint8)
    request = wire.pack(SegmentRequest(frames=frames)).SerializeToString()
    async with grpc.aio.insecure_channel(faulty.service.address) as channel:
        holder = channel.unary_unary(PATH)(held(), timeout=60)
        with await asyncio.to_thread(faulty.hold):
            calls = [channel.unary_unary(PATH)(request, timeout=60) for _ in range(QUEUE + 8)]
            await asyncio.to_thread(wait_until, lambda: sum(call.done() for call in calls) == 8, 60)
        results = await asyncio.gather(holder, *calls, return_exceptions=True)
    for error in (result for result in results if isinstance(result, grpc.aio.AioRpcError)):
        assert error.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
        status = await status_of(error)
        retry = error_details_pb2.RetryInfo()
        assert any(detail.Unpack(retry) for detail in status.details)
        assert retry.retry_delay.seconds == 1
    answers = [wire.message_type(SegmentResponse).FromString(r) for r in results if isinstance(r, bytes)]
    assert [list(answer.labels) for answer in answers] == [[0, 0]] * (1 + QUEUE)


def held() -> bytes:
    """Returns a request of gRPC that asks to be held."""
    frames = np.zeros((2, 4, 4, 3), np.uint8)
    frames[0, 0, 0, 0] = HELD
    return wire.pack(SegmentRequest(frames=frames)).SerializeToString()


async def status_of(error: grpc.aio.AioRpcError) -> Any:
    class _Call:
        def trailing_metadata(self) -> Any:
            return error.trailing_metadata()

        def code(self) -> Any:
            return error.code()

        def details(self) -> Any:
            return error.details()

    return rpc_status.from_call(_Call())


@pytest.mark.fault("C11")
def test_images_count_as_large_as_they_are_once_decoded(
    start_faulty: Callable[..., Any], refusal: Any, wait_until: Any
) -> None:
    faulty, count = start_faulty(FAULTY_SIDE="1000"), 60  # 180 MB of 512, of 60 times 3 kB

    def send(first_pixel: tuple[int, int, int] = (0, 0, 0)) -> httpx.Response:
        image, written = PIL.Image.new("RGB", (1000, 1000)), io.BytesIO()
        image.putpixel((0, 0), first_pixel)
        image.save(written, "PNG")
        files = [("images", (f"{t}.png", written.getvalue())) for t in range(count)]
        return faulty.http.post("/v1/segment", files=files)

    with ThreadPoolExecutor(2) as pool:
        calls = [pool.submit(send, (HELD, 0, 0))]
        with faulty.hold():
            calls.append(pool.submit(send))
            wait_until(lambda: faulty.metric("freerein_queued_items") == 1, 60)
            assert "decoded images" in refusal(send(), 429)["detail"]
        assert [call.result().status_code for call in calls] == [200, 200]
    assert send().status_code == 200


# --- callers that go away


def send_and_leave(faulty: Any, body: bytes, *, sent: int) -> socket.socket:
    """Sends the first bytes of a request to segment, and returns the connection, to be closed by the caller."""
    lines = ("POST /v1/segment HTTP/1.1", "host: localhost", "content-type: application/json")
    head = "\r\n".join([*lines, f"content-length: {len(body)}", "", ""]).encode()
    connection: socket.socket = faulty.connect()
    connection.sendall((head + body)[:sent])
    return connection


@pytest.mark.fault("C12")
def test_callers_that_go_away_free_their_places_and_never_reach_the_model(
    faulty: Any, least_of_many: Any, wait_until: Any
) -> None:
    body = json.dumps(faulty.trajectory([0, 1])).encode()
    slow = json.dumps(faulty.trajectory([0, 1], fault="held")).encode()

    def seconds_until_free() -> float:
        batches, cancelled = faulty.metric("freerein_batch_size_sum"), faulty.metric(CANCELLED)
        with contextlib.closing(send_and_leave(faulty, slow, sent=10**6)) as holder:
            with faulty.hold():
                waiting = [send_and_leave(faulty, body, sent=10**6) for _ in range(QUEUE)]
                wait_until(lambda: faulty.metric("freerein_queued_items") == QUEUE, 60)
                for connection in waiting:
                    connection.close()
                seconds = wait_until(lambda: faulty.metric("freerein_queued_items") == 0, 60)
            assert holder.recv(65536).startswith(b"HTTP/1.1 200")
        wait_until(lambda: faulty.metric(CANCELLED) == cancelled + QUEUE, 60)
        assert faulty.metric("freerein_batch_size_sum") == batches + 1
        return seconds

    assert least_of_many(seconds_until_free, below=0.1) < 0.1


CANCELLED = 'freerein_cancelled_total{protocol="rest"}'
IN_FLIGHT = 'freerein_calls_in_flight{protocol="rest"}'  # of which one is the reading of the metrics


@pytest.mark.fault("C12")
def test_callers_that_go_away_at_any_moment_leave_nothing_behind(faulty: Any, wait_until: Any, fuzz: bool) -> None:
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
    wait_until(lambda: faulty.metric(IN_FLIGHT) == 1, 60)
    assert faulty.metric("freerein_queued_items") == 0
    assert faulty.segment(6, 7).json()["labels"] == [0, 1]


@pytest.mark.fault("C12")
async def test_grpc_calls_that_are_cancelled_never_reach_the_model(faulty: Any, wait_until: Any) -> None:
    batches = faulty.metric("freerein_batch_size_sum")
    frames = np.zeros((1, 4, 4, 3), np.uint8)
    quick = wire.pack(SegmentRequest(frames=frames)).SerializeToString()
    async with grpc.aio.insecure_channel(faulty.service.address) as channel:
        holder = channel.unary_unary(PATH)(held(), timeout=60)
        with await asyncio.to_thread(faulty.hold):
            waiting = [channel.unary_unary(PATH)(quick, timeout=60) for _ in range(QUEUE)]
            await asyncio.to_thread(wait_until, lambda: faulty.metric("freerein_queued_items") == QUEUE, 60)
            for call in waiting:
                call.cancel()
            await asyncio.to_thread(wait_until, lambda: faulty.metric("freerein_queued_items") == 0, 60)
        await holder
    await asyncio.to_thread(wait_until, lambda: faulty.metric('freerein_calls_in_flight{protocol="grpc"}') == 0, 60)
    assert faulty.metric("freerein_batch_size_sum") == batches + 1
    assert faulty.metric('freerein_cancelled_total{protocol="grpc"}') >= QUEUE
