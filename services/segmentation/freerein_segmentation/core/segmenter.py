"""`Segmenter`: labels trajectories with skills. Validates requests, runs the model in batches, decodes its output."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.errors import InvalidInput, OutputNotFinite, ServiceError, TooLarge
from freerein.serving.batcher import Batcher
from freerein.serving.call_timer import CallTimer
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ActionSpec, Camera, Image, ModelRef
from freerein.types.segmentation import ListSkillsRequest, ListSkillsResponse, SegmentRequest, SegmentResponse
from freerein_segmentation.core import decoding
from freerein_segmentation.model import Prediction

MAX_TIMESTEPS = 20_000
MAX_MIN_SEGMENT = 1_000
MAX_SMOOTHING = 100.0


class SkillModel(Protocol):
    """A trained segmentation model, as the core uses it.

    Attributes:
        skills: The skills; labels are indices into them.
        camera: The camera whose frames it takes.
        action: The action space; None for a model without actions.
    """

    skills: tuple[str, ...]
    camera: Camera
    action: ActionSpec | None

    def predict(self, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> Prediction:
        """Returns the prediction for frames (T, H, W, C) and actions (T, A), in bounded memory."""


@dataclass(frozen=True, eq=False)
class _Item:
    model: SkillModel
    frames: npt.NDArray[np.uint8]
    actions: npt.NDArray[Any] | None


def segment_batch(items: Sequence[_Item]) -> list[Prediction | ServiceError]:
    """Returns the prediction for each trajectory, or its error."""
    return [_check_output(item, item.model.predict(item.frames, item.actions)) for item in items]


@dataclass(frozen=True, eq=False)
class Segmenter:
    """The core of the segmentation service."""

    models: ModelCache[SkillModel]
    batcher: Batcher[_Item, Prediction]
    timeout_s: float

    async def list_skills(self, request: ListSkillsRequest) -> ListSkillsResponse:
        """Returns the skills and the expected inputs of a model; raises as `ModelCache.resolve`."""
        ref, model = await self.models.resolve(request.model)
        return ListSkillsResponse(
            skills=model.skills,
            model=ref,
            height=model.camera.height,
            width=model.camera.width,
            channels=model.camera.channels,
            action_size=model.action.size if model.action else 0,
            action_choices=model.action.choices if model.action else 0,
        )

    async def segment(self, request: SegmentRequest) -> SegmentResponse:
        """Returns a label for every timestep of a trajectory.

        Raises:
            InvalidInput: An option, the frames or the actions are not what the model expects.
            TooLarge: The trajectory is too long.
            NotFound, FailedPrecondition: There is no such model, or no active one.
        """
        timer = CallTimer()
        ref, model, frames = await timer.decode(self._inputs(request))
        item = _Item(model, frames, request.actions if model.action else None)
        prediction = await timer.infer(self.batcher.submit(item, key=ref, timeout_s=self.timeout_s))
        labels, confidence, segments = await asyncio.to_thread(
            decoding.decode,
            prediction.probabilities,
            skills=model.skills,
            smoothing=request.smoothing,
            min_segment=request.min_segment,
            min_kept=request.min_kept,
        )
        return SegmentResponse(
            labels, confidence, prediction.in_distribution, segments, model.skills, ref, timer.timing()
        )

    async def _inputs(self, request: SegmentRequest) -> tuple[ModelRef, SkillModel, npt.NDArray[np.uint8]]:
        _check_options(request)
        ref, model = await self.models.resolve(request.model)
        frames = await _frames(request, model.camera)
        _check_trajectory(model, frames, request.actions)
        return ref, model, frames


def _check_output(item: _Item, prediction: Prediction) -> Prediction | ServiceError:
    timesteps, skills = len(item.frames), len(item.model.skills)
    if prediction.probabilities.shape != (timesteps, skills) or prediction.in_distribution.shape != (timesteps,):
        raise ValueError(f"the model returned {prediction.probabilities.shape}, expected {(timesteps, skills)}")
    if np.isfinite(prediction.probabilities).all() and np.isfinite(prediction.in_distribution).all():
        return prediction
    return OutputNotFinite(
        "The model's output must be finite; it overflowed.",
        field="actions",
        hint="Scale actions as in the training data.",
    )


def _check_options(request: SegmentRequest) -> None:
    for name, length in (("min_segment", request.min_segment), ("min_kept", request.min_kept)):
        if length > MAX_MIN_SEGMENT:
            raise InvalidInput(
                f"`{name}` must be at most {MAX_MIN_SEGMENT} timesteps; got {length}.",
                field=name,
                hint="5 is usual, as in the dissertation.",
            )
    if not 0.0 <= request.smoothing <= MAX_SMOOTHING:
        raise InvalidInput(
            f"`smoothing` must be in [0, {MAX_SMOOTHING:g}] timesteps; got {request.smoothing:g}.",
            field="smoothing",
            hint="One or two timesteps are usual.",
        )


async def _frames(request: SegmentRequest, camera: Camera) -> npt.NDArray[np.uint8]:
    """Returns the request's frames, uint8 (T, H, W, C); encoded images are decoded off the event loop."""
    images.check_one_form(has_frames=request.frames is not None, has_images=bool(request.images))
    if request.frames is not None:
        return images.check_frames(request.frames, axis="T")
    return await asyncio.to_thread(_decode, request.images, (camera.height, camera.width))


def _decode(encoded: Sequence[Image], size: tuple[int, int]) -> npt.NDArray[np.uint8]:
    if len(encoded) > MAX_TIMESTEPS:
        raise InvalidInput(
            f"`images` must hold at most {MAX_TIMESTEPS} images; got {len(encoded)}.",
            field="images",
            hint="Send the trajectory in parts.",
        )
    total = images.pixel_count(encoded[0], field="images.0") * len(encoded)  # all have one size
    images.check_total_pixels(total, hint="Scale the images to the size that ListSkills returns.")
    first = images.decode(encoded[0], field="images.0", size=size)
    frames = np.empty((len(encoded), *first.shape), np.uint8)
    frames[0] = first
    for t, image in enumerate(encoded[1:], start=1):
        pixels = images.decode(image, field=f"images.{t}", size=size)
        if pixels.shape != first.shape:
            raise InvalidInput(
                f"`images` must all be gray or all colour; image 0 has {first.shape}, image {t} has {pixels.shape}.",
                field=f"images.{t}",
                hint="Convert them first.",
            )
        frames[t] = pixels
    return frames


def _check_trajectory(model: SkillModel, frames: npt.NDArray[np.uint8], actions: npt.NDArray[Any] | None) -> None:
    if len(frames) > MAX_TIMESTEPS:
        raise TooLarge(
            f"A trajectory must have at most {MAX_TIMESTEPS} timesteps; got {len(frames)}.",
            field="frames",
            hint="Send the trajectory in parts.",
        )
    expected = (model.camera.height, model.camera.width, model.camera.channels)
    if frames.shape[1:] != expected:
        raise InvalidInput(
            f"Frames must have height, width and channels {expected}, as in training; got {frames.shape[1:]}.",
            field="frames",
            hint="Scale the frames, or name another model.",
        )
    if model.action:
        _check_actions(model.action, actions, len(frames))


def _check_actions(action: ActionSpec, actions: npt.NDArray[Any] | None, timesteps: int) -> None:
    expected = (timesteps, action.size)
    if actions is None or actions.dtype != action.dtype or actions.shape != expected:
        got = "none" if actions is None else f"{actions.dtype} {actions.shape}"
        raise InvalidInput(
            f"`actions` must be {action.dtype} {expected}, one row per frame; got {got}.",
            field="actions",
            hint="Send the executed action of each timestep, in the format that ListSkills returns.",
        )
    low, high = action.bounds
    if not ((actions >= low) & (actions <= high)).all():  # False for NaN
        raise InvalidInput(
            f"`actions` must be finite and in [{low:g}, {high:g}]; some are not.",
            field="actions",
            hint="Scale actions as in the training data.",
        )
