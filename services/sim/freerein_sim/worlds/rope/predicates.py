"""Predicates and measures of the rope world, on true states: the points of the rope in metres."""

from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt

from freerein.errors import must_be
from freerein_sim.worlds.measures import StateMeasure, Values
from freerein_sim.worlds.predicates import AT_LANDMARK, Flags, StatePredicate, States
from freerein_sim.worlds.rope.knots import Points, crossings, is_knotted
from freerein_sim.worlds.rope.spec import KNOT, LINKS, POINTS, S_SHAPE
from freerein_sim.worlds.rope.tps_rpm import register

_FARTHEST_M = 10.0
LANDMARK_M = 0.03
"""Mean distance of the rope's points from those of a landmark within which it is there."""

_HALF_TURN_RAD = np.radians(120)
"""How far each half of an S turns at least; that of a half circle is 180 degrees."""


def is_s_shape(points: Points) -> bool:
    """Returns whether a curve is an S: one half turns left, the other right, and it does not cross itself.

    It is the letter, not its mirror image; which of its ends is the first does not matter.
    """
    steps = np.diff(points[:, :2], axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    begin, middle, end = headings[[0, LINKS // 2, -1]]
    turns = middle - begin >= _HALF_TURN_RAD and middle - end >= _HALF_TURN_RAD
    return bool(turns) and not len(crossings(points).over)


SHAPES: dict[str, Callable[[Points], bool]] = {KNOT: is_knotted, S_SHAPE: is_s_shape}
"""Predicates that hold where a skill has been executed."""


def _has_shape(shape: Callable[[Points], bool], states: States) -> Flags:
    rows = states.reshape(-1, POINTS, 3)
    return np.array([shape(row) for row in rows], np.bool_).reshape(states.shape[:2])


def _has_become(shape: Callable[[Points], bool], states: States) -> Flags:
    """It has the shape, and did not have it in the first state."""
    holds = _has_shape(shape, states)
    return np.asarray(holds & ~holds[:, :1])


def _is_at(states: States, references: States) -> Flags:
    apart: npt.NDArray[np.float64] = (states - references).reshape(*states.shape[:2], POINTS, 3)
    return np.asarray(np.linalg.norm(apart, axis=-1).mean(axis=-1) <= LANDMARK_M)


def _registration_costs(states: States, references: States) -> Values:
    """Returns what it costs to warp the rope, seen from above, onto the references.

    Raises:
        InvalidInput: A point is nowhere near the table.
    """
    for name, each in (("states", states), ("references", references)):
        if np.abs(each).max() > _FARTHEST_M:
            raise must_be(name, f"within {_FARTHEST_M:g} m of the table's middle", f"{np.abs(each).max():g} m")
    pairs = zip(*(each.reshape(-1, POINTS, 3)[..., :2] for each in (states, references)), strict=True)
    return np.array([register(*pair).cost_m for pair in pairs]).reshape(states.shape[:2])


PREDICATES = (
    StatePredicate(AT_LANDMARK, _is_at, needs_reference=True),
    *(StatePredicate(skill, partial(_has_shape, shape)) for skill, shape in SHAPES.items()),
    *(StatePredicate(f"completed/{skill}", partial(_has_become, shape)) for skill, shape in SHAPES.items()),
)
"""The predicates of the task."""

TPS_RPM = "tps-rpm"
MEASURES = (StateMeasure(TPS_RPM, _registration_costs, unit="m", needs_reference=True),)
"""The measures of the task."""
