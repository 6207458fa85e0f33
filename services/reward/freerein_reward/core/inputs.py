"""Validation and decoding of requests: texts, images, frames by camera. The contract bounds their number and length."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.errors import InvalidInput, TooLarge, must_be, quoted
from freerein.goal_text import words
from freerein.learning.trajectories import TrajectoryArrays
from freerein.types.common import Image
from freerein.types.reward import RewardRequest
from freerein_reward.core.models import RewardModel

MAX_FRAMES = 20_000
MAX_HEATMAP_PIXELS = 12_000_000  # 64 MiB, the largest message, as FP32 in base64

_MOST_STRETCHED = 0.04
"""Difference of proportions that is none: of small frames, that of a pixel."""

Pixels = npt.NDArray[np.uint8]
Preprocess = Callable[[Pixels], Pixels]
FrameSequence = TrajectoryArrays[np.uint8]
"""Frames of one camera, uint8 (h, w, 1 or 3) each."""


def check_goal_text(text: str) -> None:
    """Raises InvalidInput when a goal text has no words."""
    _check_text(text, "goal_text", "Describe the goal, such as: a red block on top of a yellow block.")


def check_rivals(rivals: Sequence[str]) -> None:
    """Raises InvalidInput when a rival has no words."""
    for index, rival in enumerate(rivals):
        _check_text(rival, f"rivals.{index}", "Leave it out, or describe another scene.")


def check_distinct(rivals: Sequence[str], goal_text: str) -> None:
    """Raises InvalidInput when a rival, as it was read, is the goal text."""
    for index, rival in enumerate(rivals):
        if rival == goal_text:
            raise InvalidInput(
                f"`rivals` must say something else than the goal text; rival {index} says the same.",
                field=f"rivals.{index}",
                hint="Leave it out.",
            )


def check_phrases(phrases: Sequence[str], *, least: int) -> None:
    """Raises InvalidInput when there are too few phrases, or one is repeated or has no words."""
    if len(phrases) < least:
        raise InvalidInput(
            f"`phrases` must hold at least {least} noun phrases; got {len(phrases)}.",
            field="phrases",
            hint="Send one for each object, such as: a red block.",
        )
    for index, phrase in enumerate(phrases):
        _check_text(phrase, f"phrases.{index}", "Name an object, such as: a red block.")
        if phrase in phrases[:index]:
            got, field = f"phrase {index} again", f"phrases.{index}"
            raise must_be("`phrases`", "distinct", got, field=field, hint="Send each phrase once.")


def _check_text(text: str, field: str, hint: str) -> None:
    if not words(text):
        raise InvalidInput(f"`{field}` must hold words; got none.", field=field, hint=hint)


def decode_image(image: Image, preprocess: Preprocess, *, phrases: int) -> tuple[Pixels, tuple[int, int]]:
    """Returns the model's input, uint8 (1, H, W, 3), and the image's own height and width.

    Raises InvalidInput for an image that is corrupt or too large, or whose heatmaps for so many phrases would be, and
    UnsupportedMedia for another encoding than declared.
    """
    pixels = phrases * images.pixel_count(image, field="image")
    if pixels > MAX_HEATMAP_PIXELS:
        raise InvalidInput(
            f"All heatmaps together must have at most {MAX_HEATMAP_PIXELS} pixels; got {pixels} for {phrases} phrases.",
            field="image",
            hint="Scale the image down, or send fewer phrases per call.",
        )
    decoded = images.decode(image, field="image")
    return preprocess(decoded)[None], (decoded.shape[0], decoded.shape[1])


def check_pixels(encoded: Sequence[Image]) -> None:
    """Checks the total size of encoded images by their headers; raises as `freerein.images.pixel_count`."""
    total = sum(images.pixel_count(image, field=f"images.{index}") for index, image in enumerate(encoded))
    images.check_total_pixels(total, hint="Scale the images down: the model's input is smaller.")


class EncodedFrames:
    """The encoded images of one camera, decoded when indexed; `indices` are those in the request."""

    def __init__(self, encoded: Sequence[Image], indices: Sequence[int]) -> None:
        self._encoded = encoded
        self._indices = indices

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, frame: int, /) -> Pixels:
        return images.decode(self._encoded[self._indices[frame]], field=self.field(frame))

    def field(self, frame: int) -> str:
        """Returns the field of a frame in the request."""
        return f"images.{self._indices[frame]}"


def _check_aspect(frame: Pixels, model: RewardModel, camera: str, field: str) -> None:
    """Raises InvalidInput where a frame, (h, w, C), of a model's camera has other proportions than those of its fit."""
    height, width = frame.shape[:2]
    expected = model.aspects.get(camera, height / width)
    if abs(height / width / expected - 1) > _MOST_STRETCHED:
        raise InvalidInput(
            f"A frame must be {expected:.3g} times as high as it is wide, as in training, or relations would be those "
            f"of a stretched one; got {height} x {width} pixels (height x width).",
            field=field,
            hint="Crop it, or fit a model to such frames.",
        )


def model_inputs(frames: FrameSequence, model: RewardModel, camera: str, *, start: int, stop: int) -> Pixels:
    """Returns the model's inputs, uint8 (N, H, W, 3), of a camera's frames in [start, stop).

    Raises:
        InvalidInput: A frame has other proportions than those of the fit; otherwise as `images.decode`.
    """
    inputs = []
    for index in range(start, stop):
        field = frames.field(index) if isinstance(frames, EncodedFrames) else "frames"
        inputs.append(model_input(frames[index], model, camera, field=field))
    return np.stack(inputs)


def model_input(frame: Pixels, model: RewardModel, camera: str, *, field: str) -> Pixels:
    """Returns the model's input of a frame in a request's field; raises as `model_inputs`."""
    _check_aspect(frame, model, camera, field)
    return model.preprocess(frame)


def shaped_inputs(
    frames: FrameSequence, preprocess: Preprocess, *, start: int, stop: int
) -> tuple[Pixels, npt.NDArray[np.float64]]:
    """Returns inputs of a grounding model, and the height of each frame over its width, float64 (N,)."""
    pixels, aspects = [], []
    for index in range(start, stop):
        frame = frames[index]
        pixels.append(preprocess(frame))
        aspects.append(frame.shape[0] / frame.shape[1])
    return np.stack(pixels), np.array(aspects)


def request_frames(request: RewardRequest, cameras: Sequence[str]) -> Mapping[str, FrameSequence]:
    """Returns the frames of a request from the cameras of a model; other cameras are ignored.

    Raises:
        InvalidInput: A camera is missing, cameras differ in their number of frames, or frames have a wrong format.
        UnsupportedMedia: The data of an image is not in the declared encoding.
        TooLarge: There are too many frames.
    """
    images.check_one_form(has_frames=bool(request.frames), has_images=bool(request.images))
    field = "frames" if request.frames else "images"
    _check_count(len(request.images) // len(cameras), field)  # before any header is read
    chosen = _choose_cameras(request.frames or _encoded_by_camera(request), cameras, field)
    if request.frames:
        chosen = {camera: images.check_frames(frames, axis="N") for camera, frames in chosen.items()}
    counts = {camera: len(frames) for camera, frames in chosen.items()}
    if len(set(counts.values())) > 1:
        raise InvalidInput(
            "Every camera must have the same number of frames; "
            f"got {', '.join(f'{count} of {camera}' for camera, count in counts.items())}.",
            field=field,
            hint="A frame is one moment, seen by every camera of the model.",
        )
    _check_count(max(counts.values()), field)
    return chosen


def _encoded_by_camera(request: RewardRequest) -> Mapping[str, EncodedFrames]:
    check_pixels(request.images)
    indices: dict[str, list[int]] = {}
    for index, image in enumerate(request.images):
        indices.setdefault(image.camera, []).append(index)
    return {camera: EncodedFrames(request.images, own) for camera, own in indices.items()}


def _choose_cameras(given: Mapping[str, Any], cameras: Sequence[str], field: str) -> Mapping[str, Any]:
    """Returns the frames of a model's cameras; a single camera may be unnamed on either side."""
    if len(cameras) == len(given) == 1 and ("" in cameras or "" in given):
        return {cameras[0]: next(iter(given.values()))}
    missing = [camera for camera in cameras if camera not in given]
    if missing == [""]:
        got = quoted(", ".join(camera or "unnamed" for camera in given))
        raise must_be(
            "The request", "of one camera", got, field=field, hint="Send the frames of one; the model has any."
        )
    if missing:
        raise InvalidInput(
            f"The model needs the cameras {', '.join(cameras)}; of the {len(given)} cameras given, "
            f"none is {' or '.join(missing)}.",
            field=field,
            hint="Name the camera of every image, and send every camera of the model.",
        )
    return {camera: given[camera] for camera in cameras}


def _check_count(count: int, field: str) -> None:
    if count > MAX_FRAMES:
        raise TooLarge(
            f"A request must have at most {MAX_FRAMES} frames; got {count}.", field=field, hint="Send them in parts."
        )
