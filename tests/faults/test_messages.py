"""Bad gRPC messages over a real connection: a status that says what is wrong, and never INTERNAL."""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import grpc
import pytest
from hypothesis import given
from hypothesis import strategies as st

from freerein.api.common.v1 import common_pb2
from freerein.api.segmentation.v1 import segmentation_pb2
from freerein.errors import TooLarge
from freerein.serving.limits import Limits

pytestmark = pytest.mark.e2e
SEGMENT = "/freerein.api.segmentation.v1.SegmentationService/Segment"
START_FIT = "/freerein.api.learning.v1.FitService/StartFit"
LIMIT = Limits().message_bytes
OPTIONS = (("grpc.max_send_message_length", -1), ("grpc.max_receive_message_length", -1))
INVALID = grpc.StatusCode.INVALID_ARGUMENT
FRAMES = common_pb2.Tensor(datatype="UINT8", shape=[1, 4, 4, 3], raw=bytes(48))


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty(FREEREIN_RECEIPT_S="60")


@pytest.fixture
async def channel(faulty: Any) -> AsyncIterator[grpc.aio.Channel]:
    async with grpc.aio.insecure_channel(faulty.service.address, OPTIONS) as channel:
        yield channel


async def outcome(channel: grpc.aio.Channel, path: str, message: bytes) -> tuple[grpc.StatusCode, str]:
    try:
        await channel.unary_unary(path)(message, timeout=120)
    except grpc.aio.AioRpcError as error:
        return error.code(), error.details() or ""
    return grpc.StatusCode.OK, ""


@pytest.mark.parametrize(
    "message",
    [
        segmentation_pb2.SegmentRequest(frames=FRAMES, smoothing=float("nan")),
        segmentation_pb2.SegmentRequest(frames=FRAMES, smoothing=float("inf")),
        segmentation_pb2.SegmentRequest(frames=FRAMES, smoothing=-1.0),
        segmentation_pb2.SegmentRequest(frames=FRAMES, min_segment=2**32 - 1),
        segmentation_pb2.SegmentRequest(images=[common_pb2.Image(data=b"x")]),
        segmentation_pb2.SegmentRequest(images=[common_pb2.Image(encoding=99, data=b"x")]),
        segmentation_pb2.SegmentRequest(images=[common_pb2.Image(encoding=1, height=2**32 - 1, width=2**32 - 1)]),
        segmentation_pb2.SegmentRequest(images=[common_pb2.Image(encoding=3, data=b"GIF89a")]),
    ],
    ids=str,
)
async def test_a_value_out_of_bounds_is_refused(channel: grpc.aio.Channel, message: Any) -> None:
    assert (await outcome(channel, SEGMENT, message.SerializeToString()))[0] is INVALID


@pytest.mark.parametrize("depth", [31, 40, 1_000])
async def test_free_form_values_are_not_deep(channel: grpc.aio.Channel, depth: int) -> None:
    value = b""
    for _ in range(depth):  # Value.list_value.values
        value = _field(6, _field(1, value))
    message = _field(1, b"x") + _field(3, _field(1, _field(1, b"a") + _field(2, value)))
    assert (await outcome(channel, START_FIT, message))[0] is INVALID


def _field(number: int, content: bytes) -> bytes:
    """Returns a length-delimited field, as protobuf writes it."""
    length, size = b"", len(content)
    while size > 127:
        length, size = length + bytes([size & 127 | 128]), size >> 7
    return bytes([number << 3 | 2]) + length + bytes([size]) + content


@pytest.mark.fault("G8")
@given(message=st.binary(max_size=200))
async def test_any_bytes_are_a_message_or_refused(faulty: Any, message: bytes) -> None:
    async with grpc.aio.insecure_channel(faulty.service.address) as channel:
        for path in (SEGMENT, START_FIT):
            assert (await outcome(channel, path, message))[0] in (INVALID, grpc.StatusCode.NOT_FOUND)


@pytest.mark.fault("N4")
async def test_fields_of_a_later_version_are_ignored(channel: grpc.aio.Channel) -> None:
    later = segmentation_pb2.SegmentRequest(frames=FRAMES).SerializeToString() + b"\xba\x3e\x03new"  # field 999
    assert await outcome(channel, SEGMENT, later) == (grpc.StatusCode.OK, "")


@pytest.mark.fault("I3")
async def test_a_message_of_just_the_limit_is_read_and_one_byte_more_is_not(channel: grpc.aio.Channel) -> None:
    request = segmentation_pb2.SegmentRequest(frames=FRAMES).SerializeToString()
    padding = LIMIT - len(request) - 6  # an unknown field, ignored: 2 bytes of tag, 4 of length
    request += b"\xf2\x3f" + _field(0, bytes(padding))[1:]
    assert len(request) == LIMIT
    assert (await outcome(channel, SEGMENT, request))[0] is grpc.StatusCode.OK
    code, details = await outcome(channel, SEGMENT, request + b"\0")
    assert code is grpc.StatusCode.RESOURCE_EXHAUSTED
    assert TooLarge.grpc_status == code.name
    assert "larger than max" in details


@pytest.mark.parametrize("timeout_s", [0.0, 1e-6, 1e9])
async def test_any_deadline_is_a_deadline(channel: grpc.aio.Channel, timeout_s: float) -> None:
    request = segmentation_pb2.SegmentRequest(frames=FRAMES).SerializeToString()
    if timeout_s > 1:
        assert await channel.unary_unary(SEGMENT)(request, timeout=timeout_s)
    else:
        with pytest.raises(grpc.aio.AioRpcError) as error:
            await channel.unary_unary(SEGMENT)(request, timeout=timeout_s)
        assert error.value.code() is grpc.StatusCode.DEADLINE_EXCEEDED


@pytest.mark.fault("F11")
async def test_a_deadline_that_ends_while_the_reply_is_sent_is_no_bug(channel: grpc.aio.Channel) -> None:
    frames = common_pb2.Tensor(datatype="UINT8", shape=[1, 4, 4, 3], raw=bytes((0, 1)) + bytes(46))  # 10 ms of work
    request = segmentation_pb2.SegmentRequest(frames=frames).SerializeToString()
    found = set()
    for _ in range(15):
        calls = [channel.unary_unary(SEGMENT)(request, timeout=0.002 * n) for n in range(1, 21)]
        ended = await asyncio.gather(*calls, return_exceptions=True)
        found |= {end.code() for end in ended if isinstance(end, grpc.aio.AioRpcError)}
    expired, reset = grpc.StatusCode.DEADLINE_EXCEEDED, grpc.StatusCode.UNAVAILABLE  # as a slow caller may hear of it
    assert {expired} <= found <= {expired, reset}  # and the log, which the fixture reads, tells of no bug
