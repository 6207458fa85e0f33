"""Predicates of the office world, on true states: x and y in metres, headings in degrees."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from freerein_sim.worlds.office.plan import FloorPlan, GoalPose, Point
from freerein_sim.worlds.predicates import AT_LANDMARK, Flags, StatePredicate, States

CONTACT, AT_GOAL = "contact", f"{AT_LANDMARK}/goal"
_BEGIN_M, _PASSED_M, _END_M = 0.75, 0.6, 0.3
_CONTACT = 3


def _is_at(states: States, poses: States, *, within_m: float, within_deg: float) -> Flags:
    """Returns whether the robot is within a distance of poses (..., 3 or more), and within a turn of their heading."""
    turn = np.abs((states[..., 2] - poses[..., 2] + 180) % 360 - 180)
    return np.asarray((_distance(states, poses[..., :2]) <= within_m) & (turn <= within_deg))


def _is_in_contact(states: States) -> Flags:
    return np.asarray(states[..., _CONTACT] > 0)


def _has_reached(goal: GoalPose, states: States) -> Flags:
    """The robot was not at the goal in the first state, and is now."""
    is_there = _is_at_goal(states, np.array(goal))
    return np.asarray(is_there & ~is_there[:, :1])


def _has_walked(places: Sequence[Point], states: States) -> Flags:
    """The first state was near the beginning, and later ones near each of the other places, in order."""
    passed = np.broadcast_to(_distance(states[:, :1], places[0]) <= _BEGIN_M, states.shape[:2])
    for place in places[1:]:
        within = _END_M if place == places[-1] else _PASSED_M
        passed = np.maximum.accumulate(passed & (_distance(states, place) <= within), axis=1)
    return passed


def _distance(states: States, place: object) -> States:
    return np.asarray(np.linalg.norm(states[..., :2] - np.asarray(place), axis=-1))


_is_at_landmark = partial(_is_at, within_m=0.3, within_deg=45.0)
_is_at_goal = partial(_is_at, within_m=0.5, within_deg=30.0)


def predicates_of(plan: FloorPlan) -> tuple[StatePredicate, ...]:
    """Returns the predicates of a task on a floor."""
    return (
        StatePredicate(AT_LANDMARK, _is_at_landmark, needs_reference=True),
        StatePredicate(AT_GOAL, _is_at_goal, needs_reference=True),
        StatePredicate(CONTACT, _is_in_contact),
        *(StatePredicate(f"completed/{name}", partial(_has_reached, goal)) for name, goal in plan.goals.items()),
        *(StatePredicate(f"completed/{path}", partial(_has_walked, places)) for path, places in plan.paths.items()),
    )
