"""`Segmenter`: trajectories in, skill labels out. Checks what came, runs the model in batches, decodes its answer."""

import asyncio
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.errors import InvalidInput, OutputNotFinite, ServiceError, TooLarge
from freerein.serving.batcher import Batcher
from freerein.serving.model_cache import ModelCache
from freerein.types.common import Image, Timing
from freerein.types.segmentation import (
    ListSkillsRequest,
    ListSkillsResponse,
    Segment,
    SegmentRequest,
    SegmentResponse,
)
from freerein_segmentation import decoding

MAX_TIMESTEPS = 20_000
MAX_MIN_SEGMENT = 1_000
MAX_SMOOTHING = 100.0


class SkillModel(Protocol):
    """A trained segmentation model, as the core knows it.

    Attributes:
        skills: What it labels.
        height: Of the frames it was trained on, in pixels.
        width: In pixels.
        channels: 1 or 3.
        action_size: Numbers per action; 0 without actions.
        action_choices: How many different actions there are when discrete, else 0.
    """

    skills: tuple[str, ...]
    height: int
    width: int
    channels: int
    action_size: int
    action_choices: int

    def probabilities(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> npt.NDArray[np.float32]:
        """Returns P(y_t = k), eq. 2.1: float32 (T, K), of frames (T, H, W, C), actions (T, A); in bounded memory."""


@dataclass(frozen=True, eq=False)
class _Item:
    model: SkillModel
    frames: npt.NDArray[np.uint8]
    actions: npt.NDArray[Any] | None


Probabilities = npt.NDArray[np.float32]


def segment_batch(items: Sequence[_Item]) -> list[Probabilities | ServiceError]:
    """Returns for each trajectory its skills' probabilities, or why the model has none."""
    return [_checked(item, item.model.probabilities(item.frames, item.actions)) for item in items]


class Segmenter:
    """The core of the segmentation service.

    Args:
        models: The models.
        batcher: Runs `segment_batch` on the model's thread.
        timeout_s: How long a trajectory may wait for the model, in seconds.
    """

    def __init__(
        self, models: ModelCache[SkillModel], batcher: Batcher[_Item, Probabilities], *, timeout_s: float
    ) -> None:
        self._models = models
        self._batcher = batcher
        self._timeout_s = timeout_s

    async def list_skills(self, request: ListSkillsRequest) -> ListSkillsResponse:
        """Returns what a model can label, and what it wants to see.

        Raises:
            NotFound: There is no such model.
            FailedPrecondition: None is active.
        """
        ref, model = await self._models.resolve(request.model)
        return ListSkillsResponse(
            skills=model.skills,
            model=ref,
            height=model.height,
            width=model.width,
            channels=model.channels,
            action_size=model.action_size,
            action_choices=model.action_choices,
        )

    async def segment(self, request: SegmentRequest) -> SegmentResponse:
        """Returns a label for every timestep of a trajectory.

        Raises:
            InvalidInput: The trajectory is not what the model was trained on.
            TooLarge: It is too long.
            NotFound: There is no such model.
            FailedPrecondition: None is active.
        """
        begun_ns = time.perf_counter_ns()
        _check_options(request)
        ref, model = await self._models.resolve(request.model)
        frames = await _frames(request)
        _check_trajectory(model, frames, request.actions)
        decoded_ns = time.perf_counter_ns()
        done = await self._batcher.submit(_Item(model, frames, request.actions), key=ref, timeout_s=self._timeout_s)
        answered_ns = time.perf_counter_ns()
        labels, confidence, spans = await asyncio.to_thread(
            decoding.decode, done.output, smoothing=request.smoothing, min_segment=request.min_segment
        )
        ended_ns = time.perf_counter_ns()
        return SegmentResponse(
            labels=labels,
            confidence=confidence,
            segments=tuple(Segment(span.start, span.end, model.skills[span.skill], span.confidence) for span in spans),
            skills=model.skills,
            model=ref,
            timing=Timing(
                queue_ns=answered_ns - decoded_ns - done.infer_ns,
                decode_ns=decoded_ns - begun_ns,
                infer_ns=done.infer_ns,
                encode_ns=ended_ns - answered_ns,
                total_ns=ended_ns - begun_ns,
                batch_size=done.batch_size,
            ),
        )


def _checked(item: _Item, probabilities: Probabilities) -> Probabilities | ServiceError:
    expected = (len(item.frames), len(item.model.skills))
    if probabilities.shape != expected:
        raise ValueError(f"the model answered {probabilities.shape} where {expected} is due")
    if np.isfinite(probabilities).all():
        return probabilities
    return OutputNotFinite(
        "The model's output must be finite; it overflowed on this trajectory.",
        field="actions",
        hint="Send actions of the size that the model was trained on.",
    )


def _check_options(request: SegmentRequest) -> None:
    if request.min_segment > MAX_MIN_SEGMENT:
        raise InvalidInput(
            f"`min_segment` must be at most {MAX_MIN_SEGMENT} timesteps; got {request.min_segment}.",
            field="min_segment",
            hint="The dissertation rejects segments below 5.",
        )
    if not 0.0 <= request.smoothing <= MAX_SMOOTHING:
        raise InvalidInput(
            f"`smoothing` must be in [0, {MAX_SMOOTHING:g}] timesteps; got {request.smoothing:g}.",
            field="smoothing",
            hint="One or two timesteps are usual.",
        )


async def _frames(request: SegmentRequest) -> npt.NDArray[np.uint8]:
    """Returns the request's frames, uint8 (T, H, W, C), decoded off the event loop where they are encoded."""
    if (request.frames is None) == (not request.images):
        raise InvalidInput(
            f"Exactly one of `frames` and `images` must be given; got {'both' if request.images else 'neither'}.",
            field="frames",
            hint="Send `images` over REST, `frames` over gRPC.",
        )
    if request.frames is not None:
        return _check_frames(request.frames)
    return await asyncio.to_thread(_decode, request.images)


def _check_frames(frames: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    if frames.dtype != np.uint8 or frames.ndim != 4 or frames.shape[3] not in (1, 3) or 0 in frames.shape:
        raise InvalidInput(
            "`frames` must be UINT8 of shape (T, H, W, C), T at least 1 and C 1 or 3; "
            f"got {frames.dtype} {frames.shape}.",
            field="frames",
            hint="Put channels last, and scale floats to 0..255.",
        )
    return frames


def _decode(encoded: Sequence[Image]) -> npt.NDArray[np.uint8]:
    if len(encoded) > MAX_TIMESTEPS:
        raise InvalidInput(
            f"`images` must hold at most {MAX_TIMESTEPS} images; got {len(encoded)}.",
            field="images",
            hint="Send the trajectory in parts.",
        )
    total = images.pixel_count(encoded[0], field="images.0") * len(encoded)  # they must all have one size
    if total > images.MAX_REQUEST_PIXELS:
        raise InvalidInput(
            f"`images` may have {images.MAX_REQUEST_PIXELS} pixels together; got {total}.",
            field="images",
            hint="Scale the images to the size that ListSkills names.",
        )
    first = images.decode(encoded[0], field="images.0")
    frames = np.empty((len(encoded), *first.shape), np.uint8)
    frames[0] = first
    for t, image in enumerate(encoded[1:], start=1):
        pixels = images.decode(image, field=f"images.{t}")
        if pixels.shape != first.shape:
            raise InvalidInput(
                f"`images` must all have one size; image 0 has {first.shape}, image {t} has {pixels.shape}.",
                field=f"images.{t}",
                hint="Scale them alike, and use gray or colour throughout.",
            )
        frames[t] = pixels
    return frames


def _check_trajectory(model: SkillModel, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> None:
    if len(frames) > MAX_TIMESTEPS:
        raise TooLarge(
            f"A trajectory may have at most {MAX_TIMESTEPS} timesteps; got {len(frames)}.",
            field="frames",
            hint="Send it in parts.",
        )
    expected = (model.height, model.width, model.channels)
    if frames.shape[1:] != expected:
        raise InvalidInput(
            f"Frames must be of height, width and channels {expected}, as the model was trained on; "
            f"got {frames.shape[1:]}.",
            field="frames",
            hint="Scale them, or name another model.",
        )
    if model.action_size:
        _check_actions(model, actions, len(frames))


def _check_actions(model: SkillModel, actions: npt.NDArray[Any] | None, timesteps: int) -> None:
    dtype = np.dtype(np.int64 if model.action_choices else np.float32)
    expected = (timesteps, model.action_size)
    if actions is None or actions.dtype != dtype or actions.shape != expected:
        got = "none" if actions is None else f"{actions.dtype} {actions.shape}"
        raise InvalidInput(
            f"`actions` must be {dtype} {expected}, one row for each of {timesteps} frames; got {got}.",
            field="actions",
            hint="Send the action executed at each timestep, as ListSkills describes it.",
        )
    low, high = (0, model.action_choices - 1) if model.action_choices else (-1.0, 1.0)
    if not ((actions >= low) & (actions <= high)).all():  # False for NaN
        raise InvalidInput(
            f"`actions` must be finite and in [{low:g}, {high:g}]; one is not.",
            field="actions",
            hint="Scale actions as in the dataset that the model was trained on.",
        )
