"""The scripted expert of the office world: drives to a goal, or along a path, smoothly and not quite straight."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from freerein_sim.worlds.office.plan import AHEAD_M, CELL_M
from freerein_sim.worlds.office.simulation import OfficeWorld
from freerein_sim.worlds.office.spec import FORWARD, LEFT, RIGHT, ROBOT_RADIUS_M
from freerein_sim.worlds.office.starts import direction_deg, turn_deg
from freerein_sim.worlds.recipes import check_one
from freerein_sim.worlds.walkable_grid import Places, smoothed
from freerein_sim.worlds.world import LabelledAction, skill_indices

_THERE_M, _THERE_DEG = 0.15, 9.0
"""Distance from the end, and turn from the goal's heading, at which it stops. A turn takes up to 18 degrees."""

_TURNING_DEG = (9.0, 12.0)
"""Interval of the angle, drawn for each demonstration, from which it turns rather than drives."""

_STRAY_M, _STRAY_EVERY_M = 0.08, 0.6
"""Standard deviation of how far it strays to the side, drawn anew after this length of its way."""

_AHEAD = round(AHEAD_M / CELL_M)
_PASSES_M = ROBOT_RADIUS_M + 0.03
_SHARES = np.linspace(0, 1, 9)[:, None]
"""Clearance of a straight line along which the robot passes, and where it is measured."""


class OfficeExpert:
    """Drives to the end of its skill from wherever it is; without a skill, of the episode's, or of one it draws."""

    def __init__(self, world: OfficeWorld, skills: Sequence[str], rng: np.random.Generator) -> None:
        check_one(skills)
        self._world = world
        (skill,) = tuple(skills) or world.recipe or (str(rng.choice(world.spec.skills)),)
        (self._skill,) = skill_indices(world.spec, [skill])
        self._turning = rng.uniform(*_TURNING_DEG)
        goal = world.plan.goals.get(skill)
        self._heading = None if goal is None else goal[2]
        places = world.plan.paths[skill] if goal is None else [goal[:2]]
        self._way = self._plan(np.array(places), rng)
        self._passed = 0

    def act(self) -> LabelledAction | None:
        """Returns the next action; None at the end, or where it has run into something."""
        choice = None if self._world.is_in_contact else self._choose()
        return None if choice is None else LabelledAction(np.array([choice]), self._skill)

    def succeeded(self) -> bool:
        """Returns whether it is at the end."""
        return not self._world.is_in_contact and self._choose() is None

    def _choose(self) -> int | None:
        """Returns the next choice; None at the end."""
        x, y, heading = self._world.pose
        place = np.array([x, y])
        aim = self._aim(place)
        if self._passed + _AHEAD >= len(self._way) - 1 and np.linalg.norm(self._way[-1] - place) <= _THERE_M:
            off = 0.0 if self._heading is None else turn_deg(heading, self._heading)
            if abs(off) <= _THERE_DEG:
                return None
        else:
            off = turn_deg(heading, direction_deg(place, aim))
            if abs(off) <= self._turning:
                return FORWARD
        return LEFT if off > 0 else RIGHT

    def _aim(self, place: Places) -> Places:
        """Returns the place on the way that is ahead of the nearest by `AHEAD_M`, or by less where it cuts a corner."""
        ahead = self._way[self._passed : self._passed + 3 * _AHEAD]
        self._passed += int(np.argmin(np.linalg.norm(ahead - place, axis=1)))
        candidates = self._way[min(self._passed + 1, len(self._way) - 1) :][:_AHEAD][::-1]
        for aim in candidates:
            if self._world.plan.grid.clearance(place + _SHARES * (aim - place)).min() >= _PASSES_M:
                return np.asarray(aim)
        return np.asarray(candidates[-1])

    def _plan(self, places: Places, rng: np.random.Generator) -> Places:
        """Draws a way from where it is through places, float64 (N, 2)."""
        grid = self._world.plan.grid
        ways = [grid.way(begin, end)[:-1] for begin, end in pairwise([self._world.pose[:2].copy(), *places])]
        way = np.concatenate([*ways, places[-1:]])
        smooth = grid.kept_clear(smoothed(way), way)
        strayed = grid.strayed(smooth, rng, by=_STRAY_M, every=_STRAY_EVERY_M)
        return np.concatenate([grid.kept_clear(smoothed(strayed), strayed), places[-1:]])
