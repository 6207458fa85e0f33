"""`Segment` for trajectories of any length: what is too large for one request is sent as a stream."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import aclosing

import numpy as np

from freerein import images
from freerein.clients.channel import MAX_MESSAGE_BYTES
from freerein.clients.rpc import DEADLINE_S, StreamRpc, UnaryRpc
from freerein.errors import Internal, TooLarge, Unavailable, must_be
from freerein.types.common import Timing, error_from
from freerein.types.segmentation import (
    SegmentHello,
    SegmentRequest,
    SegmentResponse,
    SegmentStreamOpened,
    SegmentStreamRequest,
    SegmentStreamResponse,
    StreamLabels,
    Timesteps,
)

_REQUEST_BYTES = MAX_MESSAGE_BYTES - 2**20  # leaves room for what is not frames
_REQUEST_TIMESTEPS = 20_000  # of one request, and of one message of a stream
_MESSAGE_PIXELS = 2**21


class SegmentRpc(UnaryRpc[SegmentRequest, SegmentResponse]):
    """`Segment`, or `SegmentStream` where the trajectory is too large for one request."""

    async def __call__(self, request: SegmentRequest, *, timeout_s: float | None = DEADLINE_S) -> SegmentResponse:
        """Sends one trajectory and returns its labels.

        Args:
            request: The trajectory.
            timeout_s: Deadline in seconds, of all attempts or of the stream; None or infinity for none.

        Raises:
            InvalidInput: There are not as many actions as frames.
            TooLarge: The trajectory is too large for one request, and short segments are to be merged, which streams
                cannot.
            FailedPrecondition: It is too large, and the model has no streams.
            ServiceError: The service refused the request, could not be reached or did not answer in time.
        """
        if not _is_too_large(request):
            return await super().__call__(request, timeout_s=timeout_s)
        count = len(request.images) if request.frames is None else len(request.frames)
        if request.actions is not None and len(request.actions) != count:
            raise must_be(
                "`actions`", f"as many as there are frames, {count}", str(len(request.actions)), field="actions"
            )
        if request.min_segment > 1:
            raise TooLarge(
                "A trajectory that is too large for one request is sent as a stream, in which short segments cannot be "
                f"merged; `min_segment` is {request.min_segment}.",
                field="min_segment",
                hint="Leave it 0, or send the trajectory in parts.",
            )
        stream = StreamRpc(SegmentStreamRequest, SegmentStreamResponse).bound_to(self._channel)
        is_open, opened = asyncio.Event(), None
        parts: list[StreamLabels] = []
        async with aclosing(stream(_messages(request, is_open), timeout_s=timeout_s)) as replies:
            async for reply in replies:
                if reply.opened is not None:
                    opened = reply.opened
                    is_open.set()
                if reply.labels is not None:
                    parts.append(reply.labels)
                if reply.error is not None:
                    raise error_from(reply.error)
                if reply.draining is not None:
                    raise Unavailable(
                        "The service must stay until the end of the stream; it is stopping.", hint="Retry."
                    )
        if opened is None or not parts:
            raise Internal("The stream must hold labels; it ended without.", hint="Report it.")
        return _joined(opened, parts)


def _is_too_large(request: SegmentRequest) -> bool:
    """Returns whether frames or images are beyond the bounds of one request."""
    if request.frames is not None:
        return request.frames.nbytes > _REQUEST_BYTES or len(request.frames) > _REQUEST_TIMESTEPS
    if len(request.images) > _REQUEST_TIMESTEPS or sum(len(image.data) for image in request.images) > _REQUEST_BYTES:
        return True
    return len(request.images) * _image_pixels(request) > images.MAX_REQUEST_PIXELS


def _image_pixels(request: SegmentRequest) -> int:
    return images.pixel_count(request.images[0], field="images.0") if request.images else 0


async def _messages(request: SegmentRequest, is_open: asyncio.Event) -> AsyncIterator[SegmentStreamRequest]:
    """Yields the Hello; then the timesteps, once it is answered: the reason of a refusal is lost while writing."""
    hello = SegmentHello(request.model, request.smoothing, request.min_kept, request.min_confidence)
    yield SegmentStreamRequest(hello)
    await is_open.wait()
    for seq, at in enumerate(_parts(request)):
        yield SegmentStreamRequest(
            timesteps=Timesteps(
                seq,
                None if request.frames is None else request.frames[at],
                request.images[at],
                None if request.actions is None else request.actions[at],
            )
        )


def _parts(request: SegmentRequest) -> Iterator[slice]:
    """Yields the timesteps of each message."""
    if request.frames is None:
        count, pixels = len(request.images), _image_pixels(request)
    else:
        count, pixels = len(request.frames), int(np.prod(request.frames.shape[1:3]))
    at_once = min(max(_MESSAGE_PIXELS // pixels, 1), _REQUEST_TIMESTEPS)
    return (slice(start, start + at_once) for start in range(0, count, at_once))


def _joined(opened: SegmentStreamOpened, parts: list[StreamLabels]) -> SegmentResponse:
    return SegmentResponse(
        labels=np.concatenate([each.labels for each in parts]),
        confidence=np.concatenate([each.confidence for each in parts]),
        in_distribution=np.concatenate([each.in_distribution for each in parts]),
        segments=tuple(segment for each in parts for segment in each.segments),
        skills=opened.model.skills,
        model=opened.model.model,
        timing=Timing(
            queue_ns=sum(each.timing.queue_ns for each in parts),
            decode_ns=sum(each.timing.decode_ns for each in parts),
            infer_ns=sum(each.timing.infer_ns for each in parts),
            encode_ns=sum(each.timing.encode_ns for each in parts),
            total_ns=sum(each.timing.total_ns for each in parts),
            batch_size=max(each.timing.batch_size for each in parts),
        ),
    )
