"""Colours and images, and how two colours are mixed by a pattern."""

import colorsys

import numpy as np
import numpy.typing as npt

SIZE_PX = 64

Colour = npt.NDArray[np.float64]
"""float64 (3,), RGB in 0 to 1."""

Pattern = npt.NDArray[np.float64]
"""float64 (H, W), share of the second colour."""

Image = npt.NDArray[np.uint8]
"""uint8 (H, W, 3), RGB, its upper row first."""


def paint(rng: np.random.Generator, pattern: Pattern, first: Colour, second: Colour) -> Image:
    """Returns two colours mixed by a pattern, with a fine and a coarse grain: uint8 (H, W, 3)."""
    height, width = pattern.shape
    grain = 0.03 * rng.standard_normal((height, width))
    coarse = 0.05 * rng.standard_normal((height // 4 + 1, width // 4))
    grain += coarse.repeat(4, axis=0)[:height].repeat(4, axis=1)
    colours = first + pattern[..., None] * (second - first)
    return quantised(colours * (1 + grain[..., None]))


def quantised(colours: npt.NDArray[np.float64]) -> Image:
    """Returns colours, float64 (H, W, 3) or (3,), in whole numbers of 0 to 255."""
    return np.clip(np.rint(255 * colours), 0, 255).astype(np.uint8)


def colour(hue: float, saturation: float, value: float) -> Colour:
    """Returns the colour of a hue, of which only the fraction counts."""
    return np.array(colorsys.hsv_to_rgb(hue % 1, saturation, value))


def gray(level: float) -> Colour:
    """Returns a gray."""
    return np.full(3, level)


def blank() -> Pattern:
    """Returns the pattern of the first colour alone."""
    return np.zeros((SIZE_PX, SIZE_PX))


def axes() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Returns row and column of each pixel."""
    rows, columns = np.mgrid[:SIZE_PX, :SIZE_PX]
    return rows, columns
