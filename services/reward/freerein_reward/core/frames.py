"""The frames of a request: by camera, of any size, decoded and resized a few at a time, off the event loop."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.errors import InvalidInput, TooLarge
from freerein.types.common import Image
from freerein.types.reward import RewardRequest
from freerein_reward.core.models import Preprocess
from freerein_reward.core.pictures import check_pixels

MAX_FRAMES = 20_000

Pixels = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Footage:
    """Frames that are decoded when they are asked for.

    Attributes:
        count: How many moments there are.
        frames: By camera, what returns the frame of a moment, uint8 (h, w, 1 or 3).
    """

    count: int
    frames: Mapping[str, Callable[[int], Pixels]]

    def views(self, preprocess: Preprocess, *, start: int, stop: int) -> dict[str, Pixels]:
        """Returns the frames of moments, by camera, uint8 (stop - start, H, W, 3), as the model sees them.

        Raises:
            InvalidInput: An image is corrupt.
            UnsupportedMedia: An image is not in the encoding it claims.
        """
        return {
            camera: np.stack([preprocess(frame(moment)) for moment in range(start, stop)])
            for camera, frame in self.frames.items()
        }


def footage_of(request: RewardRequest, cameras: Sequence[str]) -> Footage:
    """Returns the frames of a request from the cameras that a model sees; others are left aside.

    Raises:
        InvalidInput: A camera is missing, cameras differ in their number of frames, or frames are not as they must be.
        UnsupportedMedia: An image is not in the encoding it claims.
        TooLarge: There are too many frames.
    """
    if bool(request.frames) == bool(request.images):
        raise InvalidInput(
            f"Exactly one of `frames` and `images` must be given; got {'both' if request.images else 'neither'}.",
            field="frames",
            hint="Send `images` over REST, `frames` over gRPC.",
        )
    field = "frames" if request.frames else "images"
    _check_count(len(request.images) // len(cameras), field)  # before any is looked at
    given = _from_tensors(request.frames) if request.frames else _from_images(request.images)
    return _joined(_choose(given, cameras, field), field)


@dataclass(frozen=True, eq=False)
class _View:
    count: int
    frame: Callable[[int], Pixels]


def _from_tensors(frames: Mapping[str, npt.NDArray[Any]]) -> dict[str, _View]:
    for array in frames.values():
        if array.dtype != np.uint8 or array.ndim != 4 or array.shape[3] not in (1, 3) or 0 in array.shape:
            raise InvalidInput(
                "`frames` must be UINT8 of shape (N, H, W, C), N at least 1 and C 1 or 3; "
                f"got {array.dtype} {array.shape}.",
                field="frames",
                hint="Put channels last, and scale floats to 0..255.",
            )
    return {camera: _View(len(array), array.__getitem__) for camera, array in frames.items()}


def _from_images(encoded: Sequence[Image]) -> dict[str, _View]:
    check_pixels(encoded)
    places: dict[str, list[int]] = {}
    for place, image in enumerate(encoded):
        places.setdefault(image.camera, []).append(place)
    return {camera: _View(len(own), _decoder(encoded, own)) for camera, own in places.items()}


def _decoder(encoded: Sequence[Image], places: Sequence[int]) -> Callable[[int], Pixels]:
    return lambda moment: images.decode(encoded[places[moment]], field=f"images.{places[moment]}")


def _choose(given: Mapping[str, _View], cameras: Sequence[str], field: str) -> dict[str, _View]:
    """Returns the views that a model sees; where it sees one and one is given, either may be nameless."""
    if len(cameras) == len(given) == 1 and ("" in cameras or "" in given):
        return {cameras[0]: next(iter(given.values()))}
    missing = [camera for camera in cameras if camera not in given]
    if missing:
        raise InvalidInput(
            f"The model sees the cameras {', '.join(cameras)}; of the {len(given)} cameras given, "
            f"none is {' or '.join(missing)}.",
            field=field,
            hint="Name the camera of every image, and send those of each camera that the model sees.",
        )
    return {camera: given[camera] for camera in cameras}


def _joined(views: Mapping[str, _View], field: str) -> Footage:
    counts = {camera: view.count for camera, view in views.items()}
    if len(set(counts.values())) > 1:
        raise InvalidInput(
            "Every camera must have as many frames as the others; "
            f"got {', '.join(f'{count} of {camera}' for camera, count in counts.items())}.",
            field=field,
            hint="A frame is one moment, seen by every camera of the model.",
        )
    count = max(counts.values())
    _check_count(count, field)
    return Footage(count, {camera: view.frame for camera, view in views.items()})


def _check_count(count: int, field: str) -> None:
    if count > MAX_FRAMES:
        raise TooLarge(
            f"A request may have at most {MAX_FRAMES} frames; got {count}.", field=field, hint="Send them in parts."
        )
