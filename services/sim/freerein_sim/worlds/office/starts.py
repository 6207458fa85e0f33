"""Where episodes begin: poses that are free, and from which the goal is out of view.

Two views overlap where there is a place that both see. Only walls hide places, so that no overlap is missed.
"""

import math

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.office.plan import AHEAD_M, CELL_M, FloorPlan
from freerein_sim.worlds.office.rectangles import Rectangles, is_visible
from freerein_sim.worlds.office.spec import STEP_M, TURN_DEG, VIEW_DEG
from freerein_sim.worlds.walkable_grid import Places, smoothed

GOAL_STEPS = (20, 28)
"""How many actions away a goal is along a planned way; the expert, which strays, takes one or two more."""

_JITTER_M = 0.5
"""Greatest distance of a start from the beginning of a path."""

_GOAL_M = (1.0, 2.8)
_TRIES = 2000
_RAYS, _SAMPLES_M = 31, np.arange(0.2, 10, 0.2)

Pose = npt.NDArray[np.float64]
"""float64 (3,): x and y in metres, heading in degrees, 0 to 360."""


def draw_pose(rng: np.random.Generator, plan: FloorPlan) -> Pose:
    """Draws a pose, uniform over where the robot can be."""
    return _posed(rng, plan.grid.free_places)


def draw_start_of(rng: np.random.Generator, plan: FloorPlan, path: str) -> Pose:
    """Draws a pose near the beginning of a path, from which nothing is seen of what is seen there."""
    begin = pose_along(plan, path)
    near = _within(plan, begin[:2], 0, _JITTER_M)
    for _ in range(_TRIES):
        start = _posed(rng, near)
        if not overlap(plan.walls, start, begin):
            return start
    raise RuntimeError(f"no start out of view of {path}")


def draw_start_towards(rng: np.random.Generator, plan: FloorPlan, goal: Pose) -> Pose:
    """Draws a pose with no wall between it and a goal, `GOAL_STEPS` away, from which nothing of its view is seen."""
    fewest, most = GOAL_STEPS
    near = _within(plan, goal[:2], *_GOAL_M)
    for _ in range(_TRIES):
        start = _posed(rng, near)
        straight = _count_steps(np.stack([start[:2], goal[:2]]), start, goal)
        if straight > most or overlap(plan.walls, start, goal):
            continue
        way = smoothed(plan.grid.way(start[:2], goal[:2]))[:: round(AHEAD_M / CELL_M)]
        if fewest <= _count_steps(np.concatenate([way, [goal[:2]]]), start, goal) <= most:
            return start
    raise RuntimeError("no start out of view of a goal")


def pose_along(plan: FloorPlan, path: str) -> Pose:
    """Returns the beginning of a path, in its direction."""
    begin, towards = (np.array(place) for place in plan.paths[path][:2])
    return np.append(begin, direction_deg(begin, towards))


def direction_deg(begin: Places, towards: Places) -> float:
    """Returns the heading from one place, float64 (2,), to another, 0 to 360."""
    x, y = towards - begin
    return math.degrees(math.atan2(y, x)) % 360


def turn_deg(begin: float, end: float) -> float:
    """Returns the turn from one heading to another, -180 to 180, to the left positive."""
    return (end - begin + 180) % 360 - 180


def overlap(walls: Rectangles, one: Pose, other: Pose) -> bool:
    """Returns whether a camera sees in one pose a place that it sees in another."""
    angles = np.radians(one[2] + np.linspace(-VIEW_DEG / 2, VIEW_DEG / 2, _RAYS))
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=-1)  # (_RAYS, 2)
    places = (one[:2] + _SAMPLES_M[:, None, None] * rays).reshape(-1, 2)
    x, y = (places - other[:2]).T
    off = (np.degrees(np.arctan2(y, x)) - other[2] + 180) % 360 - 180
    places = places[np.abs(off) <= VIEW_DEG / 2]
    return bool((is_visible(walls, one[:2], places) & is_visible(walls, other[:2], places)).any())


def _posed(rng: np.random.Generator, places: Places) -> Pose:
    """Returns one of the grid's places, moved within its cell, in any direction."""
    place = places[rng.integers(len(places))] + rng.uniform(-CELL_M / 2, CELL_M / 2, 2)
    return np.append(place, rng.uniform(0, 360))


def _within(plan: FloorPlan, place: Places, least_m: float, most_m: float) -> Places:
    """Returns the grid's free places at a distance from a place, and in sight of it."""
    free = plan.grid.free_places
    distances = np.linalg.norm(free - place, axis=1)
    near = free[(distances >= least_m) & (distances <= most_m)]
    return np.asarray(near[is_visible(plan.walls, place, near)])


def _count_steps(way: Places, start: Pose, goal: Pose) -> float:
    """Returns about how many actions a way takes, with a turn at each of its places."""
    legs = np.diff(way, axis=0)
    headings = np.degrees(np.arctan2(legs[:, 1], legs[:, 0]))
    turns = (np.diff(np.concatenate([start[2:], headings, goal[2:]])) + 180) % 360 - 180
    length = np.linalg.norm(legs, axis=1).sum()
    return float(length / np.mean(STEP_M) + np.abs(turns).sum() / np.mean(TURN_DEG))
