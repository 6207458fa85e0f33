"""The scripted demonstrator of the bins world: it stumbles until it holds a grocery, then places it in one go.

It stands in for the dissertation's people at teleoperation, who "stumble a little bit until fully gripping the object"
(section 2.4), so that in `bins` a pick lasts two to three times as long as a place.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.bins.durations import PLAIN_STEPS, DrawTempos
from freerein_sim.worlds.bins.layout import FLOOR_M, GROCERIES, LEFT_BIN_HALF_M, LEFT_BIN_M, WALL_TOP_M, Grocery, Place
from freerein_sim.worlds.bins.simulation import BinsWorld
from freerein_sim.worlds.tempo import Tempo
from freerein_sim.worlds.world import LabelledAction, skill_indices

_OPEN, _CLOSED = 1.0, -1.0
_TIP_M = 0.014
"""How far the fingertips reach below the place between them."""

_CLEARANCE_M, _RETREAT_M, _DROP_M = 0.04, 0.10, 0.025
_HELD_M, _LIFTED_M = 0.03, 0.03
_FINE_M, _ROUGH_M, _COARSE_M, _PASSING_M = 0.007, 0.02, 0.03, 0.045
_PLACED_AROUND_M, _MISSED_BY_M, _STRAYED_SHARE = 0.02, 0.03, 0.8
_MAX_REACH_STEPS, _MAX_TRIES = 10, 3
_CLOSING_STEPS, _MAX_RELEASE_STEPS = 2, 4
_PICK_PACE, _PLACE_PACE = (0.5, 0.9), (0.85, 1.0)
_STILL_NOISE, _MOVING_NOISE = 0.01, 0.06

_HESITATION_STEPS, _MISS_STEPS = (2, 6), (1, 3)
_SHORTEST_STRAY, _SHORTEST_MISS = 4, 9


class BinsExpert:
    """Moves one grocery after the other into its compartment, all of them without skills, using the true state."""

    def __init__(
        self, world: BinsWorld, skills: Sequence[str], rng: np.random.Generator, *, draw_tempos: DrawTempos
    ) -> None:
        self._world = world
        self._skills = skill_indices(world.spec, skills) or tuple(range(len(GROCERIES)))
        self._rng = rng
        self._draw_tempos = draw_tempos
        self._steps = 0
        self._speed = 1.0
        self._fingers = _OPEN
        self._demonstration = self._demonstrate()

    def act(self) -> LabelledAction | None:
        """Returns the next action of the current skill."""
        return next(self._demonstration, None)

    def succeeded(self) -> bool:
        """Returns whether every named grocery lies in its compartment, released."""
        return all(self._world.is_placed(GROCERIES[skill]) for skill in self._skills)

    def _demonstrate(self) -> Iterator[LabelledAction]:
        horizon, count = self._world.spec.max_episode_steps, len(self._skills)
        tempos = self._draw_tempos(self._rng, count, horizon)
        for number, skill in enumerate(self._skills):
            spare = horizon - self._steps - (count - number) * PLAIN_STEPS
            for action in self._move(GROCERIES[skill], tempos[number], spare):
                self._steps += 1
                yield LabelledAction(action, skill)

    def _move(self, grocery: Grocery, tempo: Tempo, spare_steps: int) -> Iterator[npt.NDArray[np.float32]]:
        self._speed = tempo.speed
        stumbling_steps = min(tempo.hesitation_steps, spare_steps)
        for _ in range(_MAX_TRIES):
            if self._world.is_placed(grocery):
                return
            yield from self._pick(grocery, stumbling_steps)
            if self._is_held(grocery):
                yield from self._place(grocery)
            stumbling_steps = 0

    def _pick(self, grocery: Grocery, stumbling_steps: float) -> Iterator[npt.NDArray[np.float32]]:
        pace = self._rng.uniform(*_PICK_PACE)
        self._fingers = _OPEN
        yield from self._rise(grocery)
        yield from self._stumble(grocery, stumbling_steps)
        yield from self._go(self._above(grocery, self._passing_m(grocery)), _ROUGH_M, pace)
        yield from self._go(np.add(self._world.position(grocery), (0, 0, grocery.grip_m)), _FINE_M, pace)
        self._fingers = _CLOSED
        yield from self._hold(_CLOSING_STEPS)
        yield from self._go(self._above(grocery, self._carrying_m(grocery)), _COARSE_M, pace)

    def _place(self, grocery: Grocery) -> Iterator[npt.NDArray[np.float32]]:
        pace = self._rng.uniform(*_PLACE_PACE)
        around = self._rng.uniform(-_PLACED_AROUND_M, _PLACED_AROUND_M, size=2)
        x, y = np.add(grocery.compartment_m, around)
        low = FLOOR_M + grocery.below_m + grocery.grip_m + _DROP_M
        yield from self._go(np.array([x, y, self._carrying_m(grocery)]), _PASSING_M, pace)
        yield from self._go(np.array([x, y, low]), _ROUGH_M, pace)
        self._fingers = _OPEN
        for _ in range(_MAX_RELEASE_STEPS):
            if self._world.is_placed(grocery):
                break
            yield from self._hold(1)
        above = np.add(self._world.set_point, (0, 0, _RETREAT_M))
        for _ in range(round(1 / self._speed)):
            yield self._towards(above, pace)

    def _stumble(self, grocery: Grocery, steps: float) -> Iterator[npt.NDArray[np.float32]]:
        """Hesitates, strays and closes the fingers on air, for about as many steps."""
        end = self._steps + steps
        while (left := round(end - self._steps)) > 0:
            kind = self._rng.integers(3)
            if kind == 0 or left < _SHORTEST_STRAY / self._speed:
                yield from self._hold(min(left, int(self._rng.integers(*_HESITATION_STEPS))))
            elif kind == 1 or left < _SHORTEST_MISS / self._speed:
                yield from self._stray(grocery)
            else:
                yield from self._miss(grocery)

    def _stray(self, grocery: Grocery) -> Iterator[npt.NDArray[np.float32]]:
        """Goes to any place over the left bin."""
        half = _STRAYED_SHARE * np.array(LEFT_BIN_HALF_M)
        x, y = np.array(LEFT_BIN_M) + self._rng.uniform(-half, half)
        yield from self._go(np.array([x, y, self._passing_m(grocery)]), _COARSE_M, self._rng.uniform(*_PICK_PACE))

    def _miss(self, grocery: Grocery) -> Iterator[npt.NDArray[np.float32]]:
        """Closes the fingers on air, above the grocery."""
        pace = self._rng.uniform(*_PICK_PACE)
        x, y = self._world.position(grocery)[:2] + self._rng.uniform(-_MISSED_BY_M, _MISSED_BY_M, size=2)
        low = self._world.position(grocery)[2] + grocery.above_m + _CLEARANCE_M + _TIP_M
        yield from self._go(np.array([x, y, self._passing_m(grocery)]), _ROUGH_M, pace)
        yield from self._go(np.array([x, y, low]), _ROUGH_M, pace)
        self._fingers = _CLOSED
        yield from self._hold(int(self._rng.integers(*_MISS_STEPS)))
        self._fingers = _OPEN
        yield from self._hold(1)
        yield from self._rise(grocery)

    def _rise(self, grocery: Grocery) -> Iterator[npt.NDArray[np.float32]]:
        """Goes up until the gripper passes over everything."""
        x, y, z = self._world.gripper
        height = self._passing_m(grocery)
        if z < height - _COARSE_M:
            yield from self._go(np.array([x, y, height]), _COARSE_M, 1.0)

    def _hold(self, steps: int) -> Iterator[npt.NDArray[np.float32]]:
        """Stays where it is, but for noise."""
        for _ in range(steps):
            yield self._towards(self._world.set_point, 0.0)

    def _go(self, place: Place, within_m: float, pace: float) -> Iterator[npt.NDArray[np.float32]]:
        """Moves until the gripper is near a place; `pace` is a share of the skill's full speed."""
        for _ in range(round(_MAX_REACH_STEPS / self._speed)):
            if (np.abs(self._world.gripper - place) < within_m).all():
                return
            yield self._towards(place, pace)

    def _towards(self, place: Place, pace: float) -> npt.NDArray[np.float32]:
        """Returns an action towards a place, with noise that grows with the speed along each axis."""
        way = (place - self._world.set_point) / np.array(self._world.spec.action.scale[:3])
        way *= min(1.0, pace * self._speed / max(float(np.abs(way).max()), 1e-9))
        way += (_STILL_NOISE + _MOVING_NOISE * np.abs(way)) * self._rng.standard_normal(3)
        return np.asarray(np.clip(np.append(way, self._fingers), -1, 1), np.float32)

    def _is_held(self, grocery: Grocery) -> bool:
        at = self._world.position(grocery)
        off = np.abs(self._world.gripper - at - (0, 0, grocery.grip_m))
        return bool((off < _HELD_M).all() and at[2] > FLOOR_M + grocery.below_m + _LIFTED_M)

    def _above(self, grocery: Grocery, height: float) -> Place:
        x, y, _ = self._world.position(grocery)
        return np.array([x, y, height])

    def _passing_m(self, grocery: Grocery) -> float:
        """Returns the height at which the empty gripper passes over everything."""
        own = float(self._world.position(grocery)[2]) + grocery.above_m
        return max(own, self._tops_m(grocery)) + _CLEARANCE_M + _TIP_M

    def _carrying_m(self, grocery: Grocery) -> float:
        """Returns the height at which the gripper carries a grocery over everything else."""
        return self._tops_m(grocery) + _CLEARANCE_M + grocery.below_m + grocery.grip_m

    def _tops_m(self, grocery: Grocery) -> float:
        """Returns the height of walls and other groceries."""
        tops = [float(self._world.position(each)[2]) + each.above_m for each in GROCERIES if each is not grocery]
        return max(WALL_TOP_M, *tops)
