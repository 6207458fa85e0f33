"""What callers send wrongly leaves no traceback, no bytes of theirs and no line that is not JSON in the log."""

import json
from collections.abc import Callable
from typing import Any

import grpc
import pytest
from tests.faults import http2_client as http2

pytestmark = pytest.mark.e2e
SEGMENT = "/freerein.api.segmentation.v1.SegmentationService/Segment"
HEALTH = "/grpc.health.v1.Health/"
BAD_METADATA = [
    (b"x-request-id", b"\xff\xfe\x80"),
    (b"authorization", b"Bearer secret\xff"),
    (b"x-anything", "é".encode()),
    (b"grpc-timeout", b"-1S"),
    (b"grpc-timeout", b"1n"),
    (b"grpc-timeout", b"99999999H"),
    (b"some-bin", b"!!"),
]


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty()


@pytest.mark.fault("F11")
@pytest.mark.fault("I17")
def test_bad_metadata_and_expired_deadlines_leave_no_trace(faulty: Any) -> None:
    for field in BAD_METADATA:
        with http2.Http2(faulty.service.grpc_port) as connection:
            for path in (SEGMENT, HEALTH + "Check", "/no/Such"):
                call = connection.call(path, field)
                connection.send(http2.frame(http2.DATA, http2.END_STREAM, call, bytes(5)))  # an empty message
                assert connection.wait_for_end(call, 60)
    with grpc.insecure_channel(faulty.service.address) as channel:
        for microseconds in range(0, 10_000, 100):
            with pytest.raises(grpc.RpcError) as raised:
                channel.unary_unary(SEGMENT)(b"", timeout=microseconds / 1e6)
            assert raised.value.code() in (grpc.StatusCode.DEADLINE_EXCEEDED, grpc.StatusCode.INVALID_ARGUMENT)
        listed = channel.unary_unary(HEALTH + "List")(b"", timeout=60)
    assert b"freerein.api.segmentation.v1.SegmentationService" in listed
    lines = [json.loads(line) for line in faulty.service.log.read_text().splitlines()]
    assert {line["event"] for line in lines} <= {"listening", "ready", "call"}
    assert "secret" not in faulty.service.log.read_text()
