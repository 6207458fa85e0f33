"""Predicates of the doom world, on true states: x and y in map units, heading in degrees."""

from functools import partial

import numpy as np

from freerein_sim.worlds.doom.maps import DoomMap
from freerein_sim.worlds.doom.textmap import Point
from freerein_sim.worlds.predicates import AT_LANDMARK, Flags, StatePredicate, States

ARRIVED_UNITS = 40.0
"""Distance from the end of a path within which it has been walked."""

_LANDMARK_UNITS = 48.0
_OTHER_UNITS = (32.0, 64.0)
_LANDMARK_DEGREES = 45.0


def is_at(states: States, references: States, *, units: float) -> Flags:
    """Returns whether the agent is within a distance of the reference, and turned from it by 45 degrees at most."""
    turn = np.abs((states[..., 2] - references[..., 2] + 180) % 360 - 180)
    return np.asarray((_distance(states, references[..., :2]) <= units) & (turn <= _LANDMARK_DEGREES))


def _has_walked(first: Point, last: Point, states: States) -> Flags:
    """The first state was at the beginning of the path, and a later one at its end."""
    began = _distance(states[:, :1], first) <= _LANDMARK_UNITS
    arrived = _distance(states, last) <= ARRIVED_UNITS
    return np.asarray(began & np.maximum.accumulate(arrived, axis=1))


def _distance(states: States, place: object) -> States:
    return np.asarray(np.linalg.norm(states[..., :2] - np.asarray(place), axis=-1))


def predicates_of(doom_map: DoomMap) -> tuple[StatePredicate, ...]:
    """Returns the predicates of a task on a map."""
    others = (
        StatePredicate(f"{AT_LANDMARK}/{units:.0f}", partial(is_at, units=units), needs_reference=True)
        for units in _OTHER_UNITS
    )
    return (
        StatePredicate(AT_LANDMARK, partial(is_at, units=_LANDMARK_UNITS), needs_reference=True),
        *others,
        *(StatePredicate(f"completed/{path}", partial(_has_walked, *doom_map.ends(path))) for path in doom_map.routes),
    )
