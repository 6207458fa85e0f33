"""Pictures of other sizes than a model's cameras, made to fit where a robot asks for it."""

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.types.common import Camera
from freerein.types.imitation import Resize

Pixels = npt.NDArray[np.uint8]


class Resizer:
    """Makes pictures fit cameras, without changing their proportions.

    Args:
        mode: `fit` shows the whole picture between black bars; `crop` its middle, without what is too wide or too high;
            None leaves pictures as they are.

    Attributes:
        has_resized: Whether a picture was of another size.
    """

    def __init__(self, mode: Resize | None) -> None:
        self.mode = mode
        self.has_resized = False

    def resized(self, pixels: Pixels, camera: Camera) -> Pixels:
        """Returns a picture, (h, w, C), in the size of a camera, (H, W, C)."""
        size = (camera.height, camera.width)
        if self.mode is None or pixels.shape[:2] == size:
            return pixels
        self.has_resized = True
        return _cropped(pixels, size) if self.mode == "crop" else _fitted(pixels, size)


def _cropped(pixels: Pixels, size: tuple[int, int]) -> Pixels:
    height, width = pixels.shape[:2]
    kept = min(height, _share(width, size[0], size[1])), min(width, _share(height, size[1], size[0]))
    top, left = (height - kept[0]) // 2, (width - kept[1]) // 2
    middle: Pixels = images.resize(pixels[None, top : top + kept[0], left : left + kept[1]], size)[0]
    return middle


def _fitted(pixels: Pixels, size: tuple[int, int]) -> Pixels:
    height, width = pixels.shape[:2]
    inner = min(size[0], _share(size[1], height, width)), min(size[1], _share(size[0], width, height))
    top, left = (size[0] - inner[0]) // 2, (size[1] - inner[1]) // 2
    framed = np.zeros((*size, pixels.shape[2]), np.uint8)
    framed[top : top + inner[0], left : left + inner[1]] = images.resize(pixels[None], inner)[0]
    return framed


def _share(length: int, numerator: int, denominator: int) -> int:
    """Returns a length in proportion, at least 1."""
    return max(1, round(length * numerator / denominator))
