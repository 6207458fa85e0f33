"""Where phrases were found, as a picture: the image, then once more for each phrase, lit where the phrase is."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freerein.types.reward import Grounding

_DARK = 0.35
_LIGHT = np.array([255, 170, 40], np.float32)
_GAP = 4


def draw(image: npt.NDArray[np.uint8], groundings: Sequence[Grounding]) -> npt.NDArray[np.uint8]:
    """Returns the picture, uint8 (H, W', 3), of an image uint8 (H, W, 1 or 3)."""
    colour = np.broadcast_to(image, (*image.shape[:2], 3))
    gap = np.full((image.shape[0], _GAP, 3), 255, np.uint8)
    panels = [colour, *(panel for found in groundings for panel in (gap, _lit(colour, found)))]
    return np.concatenate(panels, axis=1)


def _lit(image: npt.NDArray[np.uint8], found: Grounding) -> npt.NDArray[np.uint8]:
    """Returns the image darkened where the phrase is not, with a cross at the pixel that is meant."""
    heat = found.heatmap[:, :, np.newaxis]
    lit = image * (_DARK + (1 - _DARK) * heat) * (1 - heat / 2) + _LIGHT * (heat / 2)
    height, width = image.shape[:2]
    x, y = min(int(found.x), width - 1), min(int(found.y), height - 1)
    arm = max(1, min(height, width) // 20)
    lit[y, max(0, x - arm) : x + arm + 1] = 255
    lit[max(0, y - arm) : y + arm + 1, x] = 255
    return lit.astype(np.uint8)
