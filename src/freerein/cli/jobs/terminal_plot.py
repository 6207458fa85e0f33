"""Line plots for a terminal, in Braille characters of two by four dots."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

_BLANK = 0x2800
_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])  # from the top down, left and right


def plot(values: Sequence[float], *, width: int, height: int) -> list[str]:
    """Returns finite values as a plot of `height` lines, top line first, scaled from the least value to the greatest.

    Values are interpolated where there are fewer than columns of dots, and averaged where there are more.
    """
    levels = _levels(_at_columns(np.asarray(values, np.float64), 2 * width), 4 * height)
    before = np.concatenate([levels[:1], levels[:-1]])
    low = np.minimum(levels, before + np.sign(levels - before))  # a column continues where the one before ended
    high = np.maximum(levels, before + np.sign(levels - before))
    rows = np.arange(4 * height)[::-1, None]  # top row first
    dots = (low <= rows) & (rows <= high)  # (4 height, 2 width)
    cells = dots.reshape(height, 4, width, 2) * _DOTS[:, None, :]
    codes = _BLANK + cells.sum(axis=(1, 3))  # (height, width)
    return ["".join(map(chr, line)) for line in codes.tolist()]


def _at_columns(values: npt.NDArray[np.float64], columns: int) -> npt.NDArray[np.float64]:
    """Returns one value for each column."""
    if len(values) > columns:
        return np.array([part.mean() for part in np.array_split(values, columns)])
    return np.interp(np.linspace(0, len(values) - 1, columns), np.arange(len(values)), values)


def _levels(values: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.int64]:
    """Returns the row of each value, counted from the bottom; equal values lie in the middle."""
    low, spread = values.min(), np.ptp(values)
    if spread == 0:
        return np.full(len(values), (count - 1) // 2)
    return np.asarray(np.rint((values - low) / spread * (count - 1)), np.int64)
