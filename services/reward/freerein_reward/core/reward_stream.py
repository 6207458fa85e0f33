"""`RewardStreamService`: rewards of frames for one goal text, as the frames arrive."""

import asyncio
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from freerein.errors import FailedPrecondition, InvalidInput, ServiceError, must_be
from freerein.goal_text import GoalText
from freerein.serving.call_timer import CallTimer
from freerein.serving.health import Health
from freerein.serving.methods import InvalidMessage
from freerein.types.common import Draining, error_message
from freerein.types.reward import (
    FrameReward,
    Mode,
    RewardFrame,
    RewardRequest,
    RewardStreamOpened,
    RewardStreamRequest,
    RewardStreamResponse,
)
from freerein_reward.core.inference import InferenceBatcher, ScoreItem, Scores
from freerein_reward.core.inputs import Pixels, model_input, request_frames
from freerein_reward.core.models import RewardModel
from freerein_reward.core.reward_core import RewardCore, judge, read_texts

Requests: TypeAlias = AsyncIterator[RewardStreamRequest | InvalidMessage]


@dataclass(frozen=True, eq=False)
class RewardStreamService:
    """Answers `RewardStream`.

    A frame is read when the one before it is answered, so that a stream holds one at a time. It shares the model with
    single frames of other streams and requests, as that of a `Reward` does.

    Attributes:
        core: Answers `Reward`, and has the models and the batcher.
        health: Tells when the service drains.
        drain_s: Time to drain that streams are told, in seconds.
    """

    core: RewardCore
    health: Health
    drain_s: float

    async def reward_stream(self, requests: Requests) -> AsyncIterator[RewardStreamResponse]:
        """Yields how the goal text was read, then a reward or an error for each frame.

        Args:
            requests: Messages; an `InvalidMessage` in place of one that could not be parsed.

        Raises:
            FailedPrecondition: The first message is not a Hello, or a later one is.
            ServiceError: The Hello is invalid, as `RewardCore.reward` raises, or a message has no `seq`.
        """
        session: _Session | None = None
        async for request in self.health.iterate_until_drain(requests):
            if session is None:
                session = await self._open(request)
                yield RewardStreamResponse(opened=session.opened)
            else:
                yield await session.answer(request)
        if self.health.draining:
            yield RewardStreamResponse(draining=Draining(self.drain_s))

    async def _open(self, request: RewardStreamRequest | InvalidMessage) -> "_Session":
        if isinstance(request, InvalidMessage):
            raise request.error
        hello = request.hello
        if hello is None or request.frame is not None:
            raise FailedPrecondition(
                "The first message of a stream must be a Hello, and nothing else; got a frame, or nothing.",
                field="hello",
                hint="Send a Hello first: model and goal text.",
            )
        ref, model = await self.core.resolve(hello)
        goal, texts = await asyncio.to_thread(read_texts, hello, model.grammar)
        embedded: Scores = (await self.core.batcher.submit(ScoreItem(ref, model, texts), key=ref)).output
        is_cut = any(each.truncated for each in embedded.goals)
        opened = RewardStreamOpened(ref, model.cameras, texts, is_cut, goal.unknown, goal.did_you_mean)
        return _Session(opened, model, goal, hello.mode, self.core.batcher)


class _Session:
    """A stream after its Hello, which `opened` answers."""

    def __init__(
        self, opened: RewardStreamOpened, model: RewardModel, goal: GoalText, mode: Mode, batcher: InferenceBatcher
    ) -> None:
        self.opened = opened
        self._model = model
        self._goal = goal
        self._mode = mode
        self._batcher = batcher
        self._last_seq = -1
        self._sizes: dict[str, tuple[int, int]] = {}

    async def answer(self, request: RewardStreamRequest | InvalidMessage) -> RewardStreamResponse:
        """Returns the reward of a frame, or its error, after which the stream is as it was.

        Raises:
            FailedPrecondition: The message is another Hello.
            ServiceError: It cannot be read, and has no `seq`.
        """
        if isinstance(request, InvalidMessage):
            if request.seq is None:
                raise request.error
            return _error(request.seq, self._check_seq(request.seq) or request.error)
        frame = request.frame
        if frame is None or request.hello is not None:
            raise FailedPrecondition(
                "After its Hello, the messages of a stream must hold a frame, and nothing else; got "
                f"{'another Hello' if request.hello is not None else 'an empty message'}.",
                field="frame",
                hint="Open another stream for another goal text.",
            )
        if error := self._check_seq(frame.seq):
            return _error(frame.seq, error)
        try:
            return RewardStreamResponse(frame.seq, reward=await self._reward(frame))
        except ServiceError as refused:
            return _error(frame.seq, refused)

    async def _reward(self, frame: RewardFrame) -> FrameReward:
        timer = CallTimer()
        views = await timer.decode(asyncio.to_thread(self._views, frame))
        item = ScoreItem(self.opened.model, self._model, self.opened.texts, views)
        scores: Scores = timer.output(await self._batcher.submit(item, key=self.opened.model))
        rewards, winners = judge(scores.similarities, self._goal, self._mode)
        return FrameReward(
            float(rewards[0]),
            float(scores.similarities[0, 0]),
            int(winners[0]),
            timer.timing(),
            float(scores.in_distribution[0]) * (not self._goal.unknown) if len(scores.in_distribution) else None,
        )

    def _views(self, frame: RewardFrame) -> Mapping[str, Pixels]:
        """Returns the model's inputs by camera, uint8 (1, H, W, 3); the first frame says the sizes of all."""
        moment = one_moment(frame, self._model.cameras)
        sizes = {camera: (pixels.shape[0], pixels.shape[1]) for camera, pixels in moment.items()}
        kept, field = self._sizes or sizes, "frames" if frame.frames else "images"
        for camera, (height, width) in sizes.items():
            if kept[camera] != (height, width):
                rows, columns = kept[camera]
                raise InvalidInput(
                    f"Frames of a stream must keep their size, {rows} x {columns} pixels (height x width); got "
                    f"{height} x {width}.",
                    field=field,
                    hint="Send what the camera first sent, or open another stream.",
                )
        views = {
            camera: model_input(pixels, self._model, camera, field=field)[None] for camera, pixels in moment.items()
        }
        self._sizes = kept
        return views

    def _check_seq(self, seq: int) -> ServiceError | None:
        """Returns the error of a `seq` that is not above the last one."""
        if seq > self._last_seq:
            self._last_seq = seq
            return None
        hint = "Number frames from 0, each once; gaps are fine."
        return must_be("`seq`", f"above {self._last_seq}", seq, field="frame.seq", hint=hint)


def one_moment(frame: RewardFrame, cameras: tuple[str, ...]) -> dict[str, npt.NDArray[np.uint8]]:
    """Returns the frame of each camera of a model, uint8 (h, w, 1 or 3).

    Raises:
        InvalidInput: A camera is missing or has several frames, or a frame has a wrong format.
        UnsupportedMedia: The data of an image is not in the declared encoding.
    """
    for pixels in frame.frames.values():
        if pixels.ndim != 3:
            hint = "Send one moment a message, channels last."
            raise must_be("frames", "UINT8 of shape (H, W, C)", f"{pixels.dtype} {pixels.shape}", hint=hint)
    batches = {camera: pixels[None] for camera, pixels in frame.frames.items()}
    found = request_frames(RewardRequest("", frames=batches, images=frame.images), cameras)
    count = len(next(iter(found.values())))
    if count > 1:
        hint = "Send one moment a message, or many by `Reward`."
        raise must_be("images", "one of each camera", f"{count} of one", hint=hint)
    return {camera: sequence[0] for camera, sequence in found.items()}


def _error(seq: int, error: ServiceError) -> RewardStreamResponse:
    return RewardStreamResponse(seq, error=error_message(error))
