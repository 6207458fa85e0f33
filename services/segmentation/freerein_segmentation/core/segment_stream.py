"""`SegmentStreamService`: labels one trajectory as it arrives."""

from collections.abc import AsyncIterator
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

from freerein.errors import DeadlineExceeded, FailedPrecondition, Overloaded, ServiceError, must_be
from freerein.serving.call_timer import CallTimer
from freerein.serving.health import Health
from freerein.serving.methods import InvalidMessage
from freerein.serving.model_cache import ModelCache
from freerein.types.common import Draining, ModelRef, error_message
from freerein.types.segmentation import (
    SegmentHello,
    SegmentStreamOpened,
    SegmentStreamRequest,
    SegmentStreamResponse,
    StreamLabels,
)
from freerein_segmentation.core.decoding import Labels
from freerein_segmentation.core.inference import SegmentationBatcher, SkillModel, finish, push
from freerein_segmentation.core.inputs import check_options, read_timesteps
from freerein_segmentation.core.segmenter import describe
from freerein_segmentation.core.stream_decoding import Finished, StreamDecoder

Requests: TypeAlias = AsyncIterator[SegmentStreamRequest | InvalidMessage]


@dataclass(frozen=True, eq=False)
class SegmentStreamService:
    """Answers `SegmentStream`.

    A message is read when the one before it is answered, so that a stream holds one at a time.

    Attributes:
        models: The models.
        batcher: Runs `run_batch` on the model's thread.
        health: Tells when the service drains.
        drain_s: Time to drain that streams are told, in seconds.
    """

    models: ModelCache[SkillModel]
    batcher: SegmentationBatcher
    health: Health
    drain_s: float

    async def segment_stream(self, requests: Requests) -> AsyncIterator[SegmentStreamResponse]:
        """Yields the model, then labels or an error for each message with timesteps, then the labels that are left.

        Args:
            requests: Messages; an `InvalidMessage` in place of one that could not be parsed.

        Raises:
            FailedPrecondition: The first message is not a Hello, a later one is, or the model has no streams.
            ServiceError: The Hello is invalid, or the model failed, after which the stream cannot go on.
        """
        session: _Session | None = None
        async for request in self.health.iterate_until_drain(requests):
            if session is None:
                session = await self._open(request)
                yield SegmentStreamResponse(opened=session.opened)
            else:
                yield await session.answer(request)
        if self.health.draining:
            yield SegmentStreamResponse(draining=Draining(self.drain_s))
        elif session is not None:
            yield await session.end()

    async def _open(self, request: SegmentStreamRequest | InvalidMessage) -> "_Session":
        if isinstance(request, InvalidMessage):
            raise request.error
        if request.hello is None or request.timesteps is not None:
            raise FailedPrecondition(
                "The first message of a stream must be a Hello, and nothing else; got timesteps, or nothing.",
                field="hello",
                hint="Send a Hello first: model and options.",
            )
        check_options(request.hello.smoothing, request.hello.min_confidence, min_kept=request.hello.min_kept)
        ref, model = await self.models.resolve(request.hello.model)
        return _Session(ref, model, request.hello, self.batcher)


class _Session:
    """One trajectory after the Hello of its stream.

    Attributes:
        opened: Answers the Hello.
    """

    def __init__(self, ref: ModelRef, model: SkillModel, hello: SegmentHello, batcher: SegmentationBatcher) -> None:
        self._model = model
        self._predictions = model.stream()
        self._decoder = StreamDecoder(
            skills=model.skills,
            smoothing=hello.smoothing,
            min_confidence=hello.min_confidence,
            min_kept=hello.min_kept,
        )
        self._batcher = batcher
        self._last_seq = -1
        self.opened = SegmentStreamOpened(describe(ref, model), (model.lag or 0) + self._decoder.lag)

    async def answer(self, request: SegmentStreamRequest | InvalidMessage) -> SegmentStreamResponse:
        """Returns the labels that a message makes final, or its error, which leaves the trajectory as it was.

        Raises:
            FailedPrecondition: The message is another Hello.
            ServiceError: It cannot be read, and has no `seq`, or the model failed.
        """
        if isinstance(request, InvalidMessage):
            if request.seq is None:
                raise request.error
            return _error(request.seq, self._check_seq(request.seq) or request.error)
        if request.timesteps is None or request.hello is not None:
            raise FailedPrecondition(
                "After its Hello, the messages of a stream must hold timesteps, and nothing else; got "
                f"{'another Hello' if request.hello is not None else 'an empty message'}.",
                field="timesteps",
                hint="Open another stream for another trajectory.",
            )
        seq = request.timesteps.seq
        if error := self._check_seq(seq):
            return _error(seq, error)
        timer = CallTimer()
        try:
            frames, actions = await timer.decode(read_timesteps(self._model, request.timesteps))
        except ServiceError as refused:
            return _error(seq, refused)
        step = partial(push, self._predictions, frames, actions)
        try:
            done = await self._batcher.submit(step, key=self)
        except (Overloaded, DeadlineExceeded) as refused:  # before the model has seen it
            return _error(seq, refused)
        final, provisional = timer.output(done)
        labels = _labels(self._decoder.push(final), self._decoder.provisional(provisional), timer)
        return SegmentStreamResponse(seq, labels=labels)

    async def end(self) -> SegmentStreamResponse:
        """Returns all labels that are left."""
        timer = CallTimer()
        done = await self._batcher.submit(partial(finish, self._predictions), key=self)
        finished = self._decoder.finish(timer.output(done))
        return SegmentStreamResponse(labels=_labels(finished, finished.timeline.labels[:0], timer))

    def _check_seq(self, seq: int) -> ServiceError | None:
        """Returns the error of a `seq` that is not above the last one."""
        if seq > self._last_seq:
            self._last_seq = seq
            return None
        hint = "Number messages from 0, each once; gaps are fine."
        return must_be("`seq`", f"above {self._last_seq}", seq, field="timesteps.seq", hint=hint)


def _labels(finished: Finished, provisional: Labels, timer: CallTimer) -> StreamLabels:
    timeline = finished.timeline
    return StreamLabels(
        finished.start,
        timeline.labels,
        timeline.confidence,
        timeline.in_distribution,
        finished.segments,
        provisional,
        timer.timing(),
    )


def _error(seq: int, error: ServiceError) -> SegmentStreamResponse:
    return SegmentStreamResponse(seq, error=error_message(error))
