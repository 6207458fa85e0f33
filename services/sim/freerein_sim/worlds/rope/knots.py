"""Whether a curve is knotted, from the crossings that a camera above sees.

The ends of a rope are free, so that its picture is a knotoid (Turaev 2012). A last segment joins them, over everything
or under everything. The determinant of the closed curve, that of its coloring matrix (Livingston 1993, chapter 3), is 1
for a curve without a knot, 3 for an overhand knot, and 5 for a figure eight. A curve is knotted where both determinants
are greater than 1: an end that lies within a loop and would slip out makes no knot.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]
"""float64 (P, 3): the corners of a curve in order; x, y and height."""

Numbers = npt.NDArray[np.float64]

_FEWEST = 3
"""Crossings of the simplest knots."""


@dataclass(frozen=True, eq=False)
class Crossings:
    """The C crossings of a curve, as seen from above.

    Attributes:
        over: float64 (C,), where the upper strands are along the curve, in segments.
        under: float64 (C,), where the lower strands are.
    """

    over: Numbers
    under: Numbers


def is_knotted(points: Points) -> bool:
    """Returns whether a curve is knotted, whether its ends are joined over or under everything."""
    return all(determinant(crossings(points, join_height=height)) > 1 for height in (np.inf, -np.inf))


def crossings(points: Points, *, join_height: float | None = None) -> Crossings:
    """Returns where a curve crosses itself.

    Args:
        points: The curve.
        join_height: Height of a segment that joins its ends; None for a curve with open ends.
    """
    corners = points if join_height is None else np.concatenate([points, points[:1]])
    begins, steps = corners[:-1], np.diff(corners, axis=0)
    first, second = np.triu_indices(len(steps), 2)
    along_first, along_second = _intersections(begins[first], steps[first], begins[second], steps[second])
    is_join = second == len(points) - 1
    found = (along_first > 0) & (along_first < 1) & (along_second > 0) & (along_second < 1) & ~(is_join & (first == 0))
    at, other_at = (first + along_first)[found], (second + along_second)[found]
    height, other_height = (np.interp(each, np.arange(len(corners)), corners[:, 2]) for each in (at, other_at))
    if join_height is not None:
        other_height[is_join[found]] = join_height
    is_over = height > other_height
    return Crossings(np.where(is_over, at, other_at), np.where(is_over, other_at, at))


def determinant(closed: Crossings) -> int:
    """Returns the determinant of a closed curve: an odd number, 1 without a knot.

    An arc goes from one lower strand to the next. At each crossing, twice the upper arc is the sum of the two that end
    there; the determinant is that of these equations without one of them and without one arc.
    """
    count = len(closed.over)
    if count < _FEWEST:
        return 1
    equations, row, ends = np.zeros((count, count)), np.arange(count), np.sort(closed.under)
    before = np.searchsorted(ends, closed.under)
    np.add.at(equations, (row, np.searchsorted(ends, closed.over) % count), 2)
    np.add.at(equations, (row, before), -1)
    np.add.at(equations, (row, (before + 1) % count), -1)
    return round(abs(float(np.linalg.det(equations[1:, 1:]))))


def _intersections(begins: Points, steps: Points, other_begins: Points, other_steps: Points) -> tuple[Numbers, Numbers]:
    """Returns where lines meet, as shares of their steps; not finite where they are parallel."""
    apart = other_begins - begins
    with np.errstate(divide="ignore", invalid="ignore"):
        area = _cross(steps, other_steps)
        return _cross(apart, other_steps) / area, _cross(apart, steps) / area


def _cross(first: Points, second: Points) -> Numbers:
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
