"""A model that misbehaves: its caller is told so, nobody else notices, and no answer is ever a 500."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
import httpx
import numpy as np
import pytest

from freerein import wire
from freerein.types.segmentation import SegmentRequest

pytestmark = pytest.mark.e2e
PATH = "/freerein.api.segmentation.v1.SegmentationService/Segment"


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty()


@pytest.mark.fault("C16")
@pytest.mark.parametrize(
    ("fault", "status", "code"),
    [
        ("raises", 503, "model_fault"),
        ("shape", 503, "model_fault"),
        ("nan", 422, "output_not_finite"),
        ("infinite", 422, "output_not_finite"),
    ],
)
def test_a_fault_of_the_model_is_told_as_one(faulty: Any, refusal: Any, fault: str, status: int, code: str) -> None:
    assert refusal(faulty.segment(0, 1, fault=fault), status)["code"] == code
    assert faulty.segment(3, 4).json()["labels"] == [1, 0]


@pytest.mark.fault("C16")
def test_those_who_share_a_batch_with_a_poisonous_request_are_answered(faulty: Any, wait_until: Any) -> None:
    def segment(n: int, fault: str) -> httpx.Response:
        reply: httpx.Response = faulty.segment(n, n, fault=fault)
        return reply

    with ThreadPoolExecutor(13) as pool:
        pool.submit(segment, 0, "held")
        with faulty.hold():
            calls = {n: pool.submit(segment, n, "right" if n % 4 else "raises") for n in range(1, 13)}
            wait_until(lambda: faulty.metric("freerein_queued_items") == 12, 60)
    for n, call in calls.items():
        reply = call.result()
        if n % 4 == 0:
            assert reply.json()["code"] == "model_fault"
        else:
            assert reply.json()["labels"] == [n % 2, n % 2]


@pytest.mark.fault("C16")
def test_five_faults_in_a_row_make_it_not_ready_and_one_answer_ready_again(faulty: Any, refusal: Any) -> None:
    assert faulty.http.get("/readyz").status_code == 200
    for _ in range(5):
        faulty.segment(0, fault="raises")
    assert "five times" in refusal(faulty.http.get("/readyz"), 503)["detail"]
    refusal(faulty.http.get("/v2/health/ready"), 503)
    assert faulty.http.get("/healthz").status_code == 200
    assert faulty.segment(3, 4).json()["labels"] == [1, 0]
    assert faulty.http.get("/readyz").status_code == 200


UNARY_S = 4.0


@pytest.mark.fault("C17")
async def test_a_model_that_hangs_is_stuck_then_not_ready_and_at_last_ends_the_process(
    start_faulty: Callable[..., Any], refusal: Any, wait_until: Any
) -> None:
    faulty = start_faulty(FREEREIN_UNARY_S=str(UNARY_S))
    begun = time.monotonic()
    assert refusal(faulty.segment(0, fault="hangs"), 504)["code"] == "deadline_exceeded"
    assert time.monotonic() - begun >= UNARY_S
    wait_until(lambda: faulty.metric("freerein_stuck_threads") == 1, 60)
    assert "busy with one call" in refusal(faulty.http.get("/readyz"), 503)["detail"]
    assert faulty.http.get("/healthz").status_code == 200
    async with grpc.aio.insecure_channel(faulty.service.address) as channel:
        with pytest.raises(grpc.aio.AioRpcError) as late:
            await channel.unary_unary(PATH)(wire.pack(SegmentRequest(frames=FRAMES)).SerializeToString(), timeout=60)
    assert late.value.code() is grpc.StatusCode.DEADLINE_EXCEEDED
    assert faulty.service.process.wait(60) == 1  # which every supervisor starts again
    assert time.monotonic() - begun >= 4 * UNARY_S
    assert '"event": "hangs"' in faulty.service.log.read_text()


FRAMES = np.zeros((1, 4, 4, 3), np.uint8)
