"""The scripted expert of the doom world: walks a path as people do, smoothly, not quite straight, with short rests."""

import math
from collections.abc import Sequence

import numpy as np

from freerein_sim.worlds.doom.floor import AHEAD_UNITS, CELL_UNITS
from freerein_sim.worlds.doom.simulation import DoomWorld
from freerein_sim.worlds.doom.spec import FORWARD, LEFT, NO_OP, RIGHT
from freerein_sim.worlds.recipes import check_one
from freerein_sim.worlds.walkable_grid import Places, smoothed
from freerein_sim.worlds.world import LabelledAction, skill_indices

_THERE_UNITS = 32.0
"""Distance from the end at which the expert stops."""

_TURNING_DEGREES = (5.0, 10.0)
"""Interval of the angle, drawn for each demonstration, from which it turns rather than walks; a turn takes 7 to 14."""

_STRAY_UNITS, _STRAY_EVERY_UNITS = 16.0, 64.0
"""Standard deviation of how far it strays to the side, drawn anew after this length of its way."""

_REST_PROBABILITY, _MOST_REST_STEPS = 0.15, 3
"""How often it rests before an action, and how long at most."""

_PATIENCE_STEPS = 20
"""Steps without progress after which it plans anew."""


class PathExpert:
    """Walks to the end of a path from wherever it is; without a skill, of the episode's path, or of one it draws."""

    def __init__(self, world: DoomWorld, skills: Sequence[str], rng: np.random.Generator) -> None:
        check_one(skills, kind="path")
        self._world = world
        self._floor = world.floor
        self._rng = rng
        paths = tuple(skills) or world.recipe or (str(rng.choice(world.spec.skills)),)
        (self._skill, *_) = skill_indices(world.spec, paths)
        self._end = np.array(world.map.ends(paths[0])[1], np.float64)
        self._turning = rng.uniform(*_TURNING_DEGREES)
        self._resting = -1
        self._passed = self._without_progress = 0
        self._way = self._plan()

    def act(self) -> LabelledAction | None:
        """Returns the next action; None at the end of the path."""
        if self.succeeded():
            return None
        return LabelledAction(np.array([self._choose()]), self._skill)

    def succeeded(self) -> bool:
        """Returns whether it is at the end of the path."""
        return bool(np.linalg.norm(self._world.pose[:2] - self._end) <= _THERE_UNITS)

    def _choose(self) -> int:
        self._resting -= 1
        if self._resting < 0 and self._rng.random() < _REST_PROBABILITY:
            self._resting = int(self._rng.integers(_MOST_REST_STEPS))
        if self._resting >= 0:
            return NO_OP
        x, y, heading = self._world.pose
        to_x, to_y = self._aim()
        off = (math.degrees(math.atan2(to_y - y, to_x - x)) - heading + 180) % 360 - 180
        if abs(off) <= self._turning:
            return FORWARD
        return LEFT if off > 0 else RIGHT

    def _aim(self) -> Places:
        """Returns the place on the way that is ahead by `AHEAD_UNITS`; plans anew after too long without progress."""
        ahead = self._way[self._passed : self._passed + round(3 * AHEAD_UNITS / CELL_UNITS)]
        nearest = int(np.argmin(np.linalg.norm(ahead - self._world.pose[:2], axis=1)))
        self._passed += nearest
        self._without_progress = 0 if nearest else self._without_progress + 1
        if self._without_progress > _PATIENCE_STEPS:
            self._passed = self._without_progress = 0
            self._way = self._plan()
        return np.asarray(self._way[min(self._passed + round(AHEAD_UNITS / CELL_UNITS), len(self._way) - 1)])

    def _plan(self) -> Places:
        """Draws a way from where it is to the end."""
        way = self._floor.way(self._world.pose[:2].copy(), self._end)
        strayed = self._floor.strayed(smoothed(way), self._rng, by=_STRAY_UNITS, every=_STRAY_EVERY_UNITS)
        return smoothed(strayed)
