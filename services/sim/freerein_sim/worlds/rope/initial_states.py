"""Initial curves of the rope, flat on the table: pure functions of a generator."""

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.rope.spec import LINK_M, LINKS, RADIUS_M, REACH_M

_CENTRE_M = 0.03
_INSIDE_M = REACH_M - 0.01
_APART_M = 3.5 * RADIUS_M
"""Least distance between points of the rope that are not neighbours."""

_NEIGHBOURS = 3
_TURNS_RAD = (2.2, 1.6, 1.0)
"""Standard deviations of how far a varied curve turns, by waves of half a period, of one and of one and a half."""

_STRAIGHT_TURN_RAD = 0.12

Curve = npt.NDArray[np.float64]
"""float64 (26, 2): x and y of the points in metres."""


def varied(rng: np.random.Generator) -> Curve:
    """Returns a curve that does not cross or touch itself, anywhere in reach."""
    return _draw(rng, np.array(_TURNS_RAD))


def straight(rng: np.random.Generator, *, from_left: bool = False) -> Curve:
    """Returns a nearly straight curve in the middle of the table, from left to right or in any direction."""
    turns = np.array([_STRAIGHT_TURN_RAD, _STRAIGHT_TURN_RAD / 2])
    return _draw(rng, turns, widest_rad=0.0 if from_left else np.pi)


def _draw(rng: np.random.Generator, turns_rad: npt.NDArray[np.float64], *, widest_rad: float = np.pi) -> Curve:
    """Returns a curve that turns by waves, around a direction within `widest_rad` of left to right."""
    middle = (np.arange(LINKS) + 0.5) / LINKS
    waves = np.cos(np.pi * np.arange(1, len(turns_rad) + 1)[:, None] * middle)  # (W, 25)
    while True:
        headings = rng.uniform(-widest_rad, widest_rad) + (turns_rad * rng.standard_normal(len(turns_rad))) @ waves
        steps = LINK_M * np.stack([np.cos(headings), np.sin(headings)], axis=1)
        curve = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        room = _INSIDE_M - np.ptp(curve, axis=0) / 2
        centre = np.clip(rng.uniform(-_CENTRE_M, _CENTRE_M, size=2), -room, room)
        curve += centre - (curve.min(axis=0) + curve.max(axis=0)) / 2
        if (room >= 0).all() and not _touches_itself(curve):
            return curve


def _touches_itself(curve: Curve) -> bool:
    first, second = np.triu_indices(len(curve), _NEIGHBOURS)
    return bool((np.linalg.norm(curve[first] - curve[second], axis=1) < _APART_M).any())
