"""The true state of the tabletop world, and its predicates. Lengths in metres; the table top is z = 0."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.predicates import Flags, StatePredicate, States
from freerein_sim.worlds.tabletop.things import FREE_BODIES, PLACED_BODIES, REACH, THINGS

_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
STATE_NAMES = (
    *(f"hand.{part}" for part in ("x", "y", "z", "pitch", "roll", "opening", "holds")),
    *(f"{name}.{part}" for name in FREE_BODIES for part in _POSE),
    *(f"{name}.{axis}" for name in (*PLACED_BODIES, "stain") for axis in "xy"),
    "stain.spots",
    *(f"cup.lip.{axis}" for axis in "xyz"),
    *(f"spoon.tip.{axis}" for axis in "xyz"),
    "bowl.radius",
    "pot.radius",
    "pot.height",
    "box.half",
    "box.height",
    "block.edge",
    "base.edge",
)
"""`hand.holds` is 1 to 5 for cup, spoon, block, ball and sponge, 0 for nothing. `cup.lip` is the middle of the cup's
rim, `spoon.tip` that of the spoon's bowl. `stain.spots` counts the spots that are not wiped away yet."""

POURING_RAD = np.radians(75)
"""Least angle between a pouring cup's axis and the vertical."""

_RESTING_M = 0.01

Numbers = npt.NDArray[np.float64]
"""float64 (N, T), one number of the state."""


def _numbers(states: States, *names: str) -> tuple[Numbers, ...]:
    return tuple(states[..., STATE_NAMES.index(name)] for name in names)


def _ever(flags: npt.NDArray[np.bool_]) -> Flags:
    return np.logical_or.accumulate(flags, axis=1)


def _distance(states: States, one: str, other: str) -> Numbers:
    """Returns the horizontal distance between two points."""
    (x, y), (other_x, other_y) = (_numbers(states, f"{each}.x", f"{each}.y") for each in (one, other))
    return np.asarray(np.hypot(x - other_x, y - other_y))


def _has_reached(states: States) -> Flags:
    """The hand has held something."""
    (holds,) = _numbers(states, "hand.holds")
    return _ever(holds > 0)


def _has_poured(states: States) -> Flags:
    """The cup, in the hand, was tilted with its lip over the bowl."""
    qx, qy, lip_z, radius = _numbers(states, "cup.qx", "cup.qy", "cup.lip.z", "bowl.radius")
    upright = 1 - 2 * (qx**2 + qy**2)  # z of the cup's axis
    over = (_distance(states, "cup.lip", "bowl") < radius) & (lip_z > 0)
    return _ever(_is_held(states, "cup") & over & (upright < np.cos(POURING_RAD)))


def _has_stirred(states: States) -> Flags:
    """The spoon's tip, in the pot, has gone once around its middle."""
    x, y, z, pot_x, pot_y = _numbers(states, "spoon.tip.x", "spoon.tip.y", "spoon.tip.z", "pot.x", "pot.y")
    radius, height = _numbers(states, "pot.radius", "pot.height")
    inside = (_distance(states, "spoon.tip", "pot") < radius) & (z < height)
    angles = np.arctan2(y - pot_y, x - pot_x)
    turns = np.diff(angles, axis=1, prepend=angles[:, :1])
    turns = (turns + np.pi) % (2 * np.pi) - np.pi
    turns[:, 1:] *= inside[:, 1:] & inside[:, :-1]
    return _ever(np.abs(np.cumsum(turns, axis=1)) >= 2 * np.pi)


def _is_stacked(states: States) -> Flags:
    """The block rests on the other one."""
    z, base_z, edge, base_edge = _numbers(states, "block.z", "base.z", "block.edge", "base.edge")
    at_height = np.abs(z - base_z - (edge + base_edge) / 2) < _RESTING_M
    return ~_is_held(states, "block") & at_height & (_distance(states, "block", "base") < base_edge / 2)


def _is_placed(states: States) -> Flags:
    """The ball is in the box."""
    z, half, height = _numbers(states, "ball.z", "box.half", "box.height")
    return ~_is_held(states, "ball") & (_distance(states, "ball", "box") < half) & (z < height)


def _is_wiped(states: States) -> Flags:
    """The sponge has covered every spot of the stain."""
    (spots,) = _numbers(states, "stain.spots")
    return np.asarray((spots[:, :1] > 0) & (spots == 0))


def _is_held(states: States, name: str) -> Flags:
    (holds,) = _numbers(states, "hand.holds")
    return np.asarray(holds == 1 + [thing.name for thing in THINGS].index(name))


COMPLETED: dict[str, Callable[[States], Flags]] = {
    REACH: _has_reached,
    "pour": _has_poured,
    "stir": _has_stirred,
    "stack": _is_stacked,
    "place": _is_placed,
    "wipe": _is_wiped,
}
"""By skill, whether it was executed since the first state."""

PREDICATES = tuple(StatePredicate(f"completed/{skill}", holds) for skill, holds in COMPLETED.items())
