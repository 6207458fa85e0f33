"""The nine spatial criteria of the dissertation's table 4.1, and its negation of `close to`, on true places.

x points to the front camera, y to its right, z up, in metres; the table top is z = 0. Criteria overlap, as in the
dissertation: what is inside the tray is close to it, too. Unlike there, left, right, in front and behind begin at half
an object's width, so that where one thing is on another, neither is to the left.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.push.things import OBJECT_M, TRAY_HEIGHT_M, Kind

SIDE_M = OBJECT_M / 2
"""Least distance between centres, along one axis, of what is left, right, in front of or behind another."""

CLOSE_M = 1.9 * OBJECT_M
"""Distance between centres below which things are close: 95 mm, or 45 mm between the edges of two pucks."""

INSIDE_M = 1.3 * OBJECT_M
"""Horizontal distance between the centres of the tray and what is inside; of what touches it outside it is 85 mm."""

_ABOVE_M = (0.36 * OBJECT_M, 1.5 * OBJECT_M)
"""How much higher the centre of a thing on top of another may be; that of a puck on a puck is seven tenths of a width
higher."""

Place = npt.NDArray[np.float64]
"""float64 (..., 3): x, y, z of centres in metres."""

Flags = npt.NDArray[np.bool_]
"""bool (...)."""


@dataclass(frozen=True, eq=False)
class Criterion:
    """A relation of a thing to another, or to two others.

    Attributes:
        name: Its name in predicates, such as `left-of`.
        text: Its words in captions.
        kinds: The kinds that it relates, for each thing in turn.
        holds: Returns where it holds of the things' places, as bool (...).
        group: Criteria of one group exclude each other; empty for no group.
    """

    name: str
    text: str
    kinds: tuple[tuple[Kind, ...], ...]
    holds: Callable[..., Flags]
    group: str = ""


def is_left(first: Place, second: Place) -> Flags:
    """Returns where the first is to the left of the second, as the front camera sees them."""
    return np.asarray(second[..., 1] - first[..., 1] > SIDE_M)


def is_in_front(first: Place, second: Place) -> Flags:
    """Returns where the first is nearer to the front camera than the second."""
    return np.asarray(first[..., 0] - second[..., 0] > SIDE_M)


def is_on_top(first: Place, second: Place) -> Flags:
    """Returns where the first is above the second, aligned with it to less than a width."""
    offset = first - second
    aligned = (np.abs(offset[..., :2]) < OBJECT_M).all(axis=-1)
    return np.asarray(aligned & (_ABOVE_M[0] < offset[..., 2]) & (offset[..., 2] < _ABOVE_M[1]))


def is_close(first: Place, second: Place) -> Flags:
    """Returns where the centres are less than `CLOSE_M` apart."""
    return np.asarray(np.linalg.norm(first - second, axis=-1) < CLOSE_M)


def is_inside(first: Place, tray: Place) -> Flags:
    """Returns where the first's centre is within the tray and below its rim."""
    offset = first - tray
    return np.asarray((np.hypot(offset[..., 0], offset[..., 1]) < INSIDE_M) & (offset[..., 2] < TRAY_HEIGHT_M / 2))


def is_between(first: Place, second: Place, third: Place) -> Flags:
    """Returns where the first has one of the others on its left and one on its right."""
    one, other = is_left(second, first) & is_left(first, third), is_left(third, first) & is_left(first, second)
    return np.asarray(one | other)


_SOLID: tuple[Kind, ...] = ("puck", "block")
_ANY: tuple[Kind, ...] = (*_SOLID, "tray")
_PAIR = (_ANY, _ANY)

CRITERIA = (
    Criterion("left-of", "to the left of", _PAIR, is_left, "side"),
    Criterion("right-of", "to the right of", _PAIR, lambda first, second: is_left(second, first), "side"),
    Criterion("on-top-of", "on top of", (_SOLID, _SOLID), is_on_top, "height"),
    Criterion("below", "below", (_SOLID, _SOLID), lambda first, second: is_on_top(second, first), "height"),
    Criterion("in-front-of", "in front of", _PAIR, is_in_front, "depth"),
    Criterion("behind", "behind", _PAIR, lambda first, second: is_in_front(second, first), "depth"),
    Criterion("close-to", "close to", _PAIR, is_close, "distance"),
    Criterion("apart-from", "apart from", _PAIR, lambda first, second: ~is_close(first, second), "distance"),
    Criterion("inside-of", "inside of", (_SOLID, ("tray",)), is_inside),
    Criterion("in-between", "in between", (_ANY, _ANY, _ANY), is_between),
)
"""The table's nine, and `apart-from`."""
