"""Checks and decodes what requests hold: options, frames, actions."""

import asyncio
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.errors import InvalidInput, TooLarge, must_be
from freerein.types.common import ActionSpec, Camera, Image
from freerein.types.segmentation import SegmentRequest, Timesteps
from freerein_segmentation.core.inference import Actions, Pixels, SkillModel

MAX_TIMESTEPS = 20_000
MAX_MIN_SEGMENT = 1_000
MAX_SMOOTHING = 100.0
MAX_FPS = 240.0


def check_options(smoothing: float, min_confidence: float, *, fps: float = 0.0, **lengths: int) -> None:
    """Raises InvalidInput when an option, or a length of segments of the name given, is out of bounds."""
    for name, length in lengths.items():
        if length > MAX_MIN_SEGMENT:
            hint = "5 is usual, as in the dissertation."
            raise must_be(name, f"at most {MAX_MIN_SEGMENT} timesteps", length, hint=hint)
    if not 0.0 <= smoothing <= MAX_SMOOTHING:
        hint = "One or two timesteps are usual."
        raise must_be("smoothing", f"in [0, {MAX_SMOOTHING:g}] timesteps", f"{smoothing:g}", hint=hint)
    if not 0.0 <= fps <= MAX_FPS:
        hint = "Leave it 0 for the rate that the model was trained on."
        raise must_be("fps", f"in [0, {MAX_FPS:g}] timesteps per second", f"{fps:g}", hint=hint)
    if not 0.0 <= min_confidence <= 1.0:
        hint = "0.8 rejects what is often wrong, such as the beginnings of skills."
        raise must_be("min_confidence", "in [0, 1]", f"{min_confidence:g}", hint=hint)


async def read_timesteps(model: SkillModel, request: SegmentRequest | Timesteps) -> tuple[Pixels, Actions]:
    """Returns the frames, uint8 (T, H, W, C), and the actions (T, A) of a request, None for a model without actions.

    Encoded images are decoded off the event loop.

    Raises:
        InvalidInput: They are not what the model expects.
        UnsupportedMedia: An image is in another encoding than it declares.
        TooLarge: There are too many timesteps.
    """
    check_one_form(request)
    if request.frames is not None:
        frames = images.check_frames(request.frames, axis="T")
    else:
        frames = await asyncio.to_thread(_decode, request.images, model.camera)
    _check_frames(model.camera, frames)
    if model.action is None:
        return frames, None
    return frames, checked_actions(model.action, request.actions, len(frames))


def check_one_form(request: SegmentRequest | Timesteps) -> None:
    """Raises InvalidInput unless exactly one of `frames`, `images` and `video` is given."""
    forms = {"frames": request.frames is not None, "images": bool(request.images)}
    if isinstance(request, SegmentRequest):
        forms["video"] = bool(request.video)
    if sum(forms.values()) != 1:
        raise InvalidInput(
            f"Exactly one of `{'`, `'.join(forms)}` must be given; got {sum(forms.values())} of them.",
            field="frames",
            hint="Send `images` over REST, `frames` over gRPC.",
        )


def checked_actions(action: ActionSpec, actions: Actions, timesteps: int | None) -> npt.NDArray[Any]:
    """Returns actions, `normalised`; raises InvalidInput when they are not (T, A) of the model's type and in bounds.

    `timesteps` is T; None while it is not known.
    """
    actions = None if actions is None else action.normalised(actions)
    if (
        actions is None
        or actions.dtype != action.dtype
        or actions.ndim != 2
        or actions.shape != (len(actions) if timesteps is None else timesteps, action.size)
    ):
        got = "none" if actions is None else f"{actions.dtype} {actions.shape}"
        rule = f"{action.dtype} ({timesteps or 'T'}, {action.size}), one row per frame"
        hint = "Send the executed action of each timestep, in the format that ListSkills returns."
        raise must_be("actions", rule, got, hint=hint)
    low, high = action.bounds
    if not ((actions >= low) & (actions <= high)).all():  # False for NaN
        rule = f"finite and in [{low:g}, {high:g}]"
        raise must_be("actions", rule, "others", hint="Scale actions as in the training data.")
    return actions


def check_length(timesteps: int, *, field: str) -> None:
    """Raises TooLarge for a trajectory of too many timesteps."""
    if timesteps > MAX_TIMESTEPS:
        raise TooLarge(
            f"A trajectory must have at most {MAX_TIMESTEPS} timesteps; got {timesteps}.",
            field=field,
            hint="Send a stream (SegmentStream), or the trajectory in parts.",
        )


def _decode(encoded: Sequence[Image], camera: Camera) -> Pixels:
    if len(encoded) > MAX_TIMESTEPS:
        raise InvalidInput(
            f"`images` must hold at most {MAX_TIMESTEPS} images; got {len(encoded)}.",
            field="images",
            hint="Send the trajectory in parts.",
        )
    total = images.pixel_count(encoded[0], field="images.0") * len(encoded)  # all have one size
    images.check_total_pixels(total, hint="Send a stream (SegmentStream), or images of the model's size.")
    size = (camera.height, camera.width)
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


def _check_frames(camera: Camera, frames: Pixels) -> None:
    check_length(len(frames), field="frames")
    expected = (camera.height, camera.width, camera.channels)
    if frames.shape[1:] != expected:
        raise InvalidInput(
            f"Frames must have height, width and channels {expected}, as in training; got {frames.shape[1:]}.",
            field="frames",
            hint="Scale the frames, or name another model.",
        )
