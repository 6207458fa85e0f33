"""The values of a gRPC message are counted before it is parsed; what cannot be parsed is a malformed request."""

import time
from collections.abc import Callable, Coroutine
from contextlib import closing
from typing import Any

import pytest
from google.protobuf.message import Message

from freerein import wire
from freerein.api.common.v1 import common_pb2
from freerein.api.imitation.v1 import imitation_pb2
from freerein.api.learning.v1 import learning_pb2
from freerein.api.segmentation.v1 import segmentation_pb2
from freerein.api.sim.v1 import sim_pb2
from freerein.errors import InvalidInput, MalformedRequest
from freerein.serving.grpc_messages import _parse, decode, decode_part
from freerein.serving.limits import FEW_VALUES, MAX_INLINE_BYTES, MAX_INLINE_IMAGE_BYTES, MAX_VALUES
from freerein.serving.methods import InvalidMessage
from freerein.types.imitation import ControlRequest
from freerein.types.learning import StartFitRequest
from freerein.types.segmentation import SegmentRequest
from freerein.types.sim import CheckRequest, ResetRequest

FIXED64, FIXED32 = b"\xa1\x06" + bytes(8), b"\xa5\x06" + bytes(4)  # of a field that no message has
TEXT = b"\xa2\x06\x03abc"


def images(count: int) -> Message:
    """Each is a field, and its encoding another one."""
    image = common_pb2.Image(encoding=common_pb2.Image.ENCODING_PNG)
    return segmentation_pb2.SegmentRequest(images=[image] * (count // 2), min_segment=count % 2)


def packed(count: int) -> Message:
    """One field, and the numbers in it."""
    return sim_pb2.ResetRequest(envs=[128] * (count - 1))


def nested(count: int) -> Message:
    """Two messages around a shape, which is a field with numbers in it."""
    return sim_pb2.CheckRequest(states=common_pb2.Tensor(shape=[1] * (count - 2)))


def struct(count: int) -> Message:
    """An item of a map is a field with a key and a value, which is one with a number."""
    request = learning_pb2.StartFitRequest(dataset="d" if count % 4 == 2 else "")
    request.config.update({str(i): float(i) for i in range((count - 1) // 4)})
    return request


@pytest.mark.fault("F2")
@pytest.mark.parametrize(
    ("make", "cls", "most"),
    [
        (images, SegmentRequest, MAX_VALUES),
        (packed, ResetRequest, MAX_VALUES),
        (nested, CheckRequest, MAX_VALUES),
        (struct, StartFitRequest, MAX_VALUES - 3),
    ],
)
def test_as_many_values_as_allowed_are_parsed_and_no_more(make: Callable[[int], Message], cls: type, most: int) -> None:
    message = make(most)
    assert _parse(message.SerializeToString(), cls) == message
    with pytest.raises(InvalidInput, match=f"at most {MAX_VALUES} values"):
        _parse(make(most + 4).SerializeToString(), cls)


@pytest.mark.fault("F2")
@pytest.mark.parametrize("field", [FIXED64, FIXED32, TEXT, b"\xa0\x06\x96\x01"])
def test_fields_that_no_message_has_are_values_too(field: bytes) -> None:
    assert not _parse(field * MAX_VALUES, SegmentRequest).ListFields()
    with pytest.raises(InvalidInput, match="values"):
        _parse(field * (MAX_VALUES + 1), SegmentRequest)


@pytest.mark.fault("F2")
def test_no_byte_is_counted_twice() -> None:
    beyond = b"\x12\x01\x12" * 10_000  # frames of one byte, which begins a shape whose length comes after the frames
    begun = time.process_time()
    with pytest.raises(MalformedRequest):
        _parse(beyond + b"\xa2\x06" + varint(30 * 2**20) + b"\xff" * 30 * 2**20, SegmentRequest)
    assert time.process_time() - begun < 5  # minutes, if each read on to the end


@pytest.mark.fault("F2")
def test_parts_of_any_length_are_passed_over() -> None:
    lengths = (1, 127, 128, 200, 16_383, 16_384, 100_000)
    parts = b"".join(b"\xa2\x06" + varint(each) + b"\xff" * each for each in lengths)
    assert not _parse(parts + TEXT * (MAX_VALUES - len(lengths)), SegmentRequest).ListFields()
    with pytest.raises(InvalidInput, match="values"):
        _parse(parts + TEXT * (MAX_VALUES - len(lengths) + 1), SegmentRequest)


def varint(number: int) -> bytes:
    more = [number >> shift & 0x7F | 0x80 for shift in range(0, 28, 7) if number >> shift + 7]
    return bytes([*more, number >> 7 * len(more)])


@pytest.mark.parametrize(
    "end",
    [b"\x1a", b"\x1a\x80", b"\x1a\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01", b"\xa3\x06", b"\x12\x05\x12\x7f\x00\x00"],
    ids=["no length", "half a length", "a length without end", "a group", "a part longer than the whole"],
)
@pytest.mark.parametrize("start", [b"", TEXT * (MAX_VALUES // 3)], ids=["small", "large"])
async def test_what_is_no_message_is_malformed(start: bytes, end: bytes) -> None:
    with pytest.raises(MalformedRequest, match="SegmentRequest"):
        await decode(start + end, SegmentRequest)


async def test_a_large_message_is_read_as_a_small_one() -> None:
    for size in (1, 2**20):
        request = imitation_pb2.ControlRequest(observed=imitation_pb2.Observed(seq=7))
        request.observed.observation.images.add(encoding=1, height=1, width=1, data=bytes(size))
        message = request.SerializeToString()
        decoded = await decode(message, ControlRequest)
        assert wire.pack(decoded) == request
        assert wire.pack(await decode_part(message, ControlRequest)) == request


async def test_a_message_of_a_stream_that_is_invalid_keeps_its_number() -> None:
    request = imitation_pb2.ControlRequest(observed=imitation_pb2.Observed(seq=7))
    request.observed.observation.images.add(data=bytes(2**20))  # without an encoding
    invalid = await decode_part(request.SerializeToString(), ControlRequest)
    assert isinstance(invalid, InvalidMessage)
    assert (invalid.seq, invalid.error.field) == (7, "observed.observation.images.0.encoding")
    hello = imitation_pb2.ControlRequest(hello=imitation_pb2.Hello(model=common_pb2.ModelRef(name="x" * 65)))
    unnumbered = await decode_part(hello.SerializeToString(), ControlRequest)
    assert isinstance(unnumbered, InvalidMessage)
    assert (unnumbered.seq, unnumbered.error.field) == (None, "hello.goal")
    broken = await decode_part(b"\x12\x7f", ControlRequest)
    assert isinstance(broken, InvalidMessage)
    assert broken.seq is None


def ends_at_once(work: Coroutine[Any, Any, object]) -> bool:
    """Returns whether work ends without leaving the event loop."""
    with closing(work):
        try:
            work.send(None)
        except StopIteration:
            return True
    return False


def image_of(size: int) -> bytes:
    image = common_pb2.Image(encoding=common_pb2.Image.ENCODING_PNG, data=bytes(size))
    return segmentation_pb2.SegmentRequest(images=[image]).SerializeToString()


async def test_images_are_decoded_on_the_event_loop_and_messages_that_take_long_are_not() -> None:
    assert MAX_INLINE_BYTES < 224 * 224 * 3 < MAX_INLINE_IMAGE_BYTES
    assert ends_at_once(decode(image_of(224 * 224 * 3), SegmentRequest))
    assert not ends_at_once(decode(image_of(MAX_INLINE_IMAGE_BYTES), SegmentRequest))
    many = segmentation_pb2.SegmentRequest(images=[common_pb2.Image(data=bytes(300))] * (FEW_VALUES // 2 + 1))
    assert many.ByteSize() < MAX_INLINE_BYTES
    many.images[0].data = bytes(MAX_INLINE_BYTES)
    assert not ends_at_once(decode(many.SerializeToString(), SegmentRequest))


async def test_a_long_message_that_cannot_be_read_is_refused_on_the_event_loop() -> None:
    with pytest.raises(MalformedRequest):
        ends_at_once(decode(image_of(MAX_INLINE_BYTES)[:-1], SegmentRequest))
