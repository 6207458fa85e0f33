"""The scripted expert of the blocks world: picks and places blocks with random speed, noise and pauses."""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein_sim.worlds.blocks.goals import BlockGoal
from freerein_sim.worlds.blocks.relations import BLOCK_M, PLACED_ASIDE_M, BlockRelation, Position, is_on, is_on_table
from freerein_sim.worlds.blocks.simulation import BlocksWorld
from freerein_sim.worlds.world import LabelledAction

_GRASP_ABOVE_M = 0.018
"""Height above a block's centre at which the fingers close."""

_OVER_M = 0.075
"""Height above the highest obstacle at which the gripper travels."""

_OPEN_M, _RELEASE_M, _CLOSED_M = 0.034, 0.031, 0.0
_FREE_M = 0.077
"""Smallest distance between blocks on the table that leaves room for the gripper."""

_LINE_M = np.linspace(-0.21, 0.21, 421)
_NEARBY_M = 0.05
_PLACED_M = 0.025
_STACK_PROBABILITY = 0.35
_FINE_M = 0.004
_ALIGNED, _ROUGHLY = (_FINE_M, 0.02), (0.02, 0.02)
_RETREAT_M = 0.06
_MAX_REACH_STEPS = 25
_MAX_TRIES = 3
_SPEED = (0.7, 1.0)
_NOISE = 0.06
_PAUSE_PROBABILITY = 0.02


@dataclass(frozen=True)
class _Waypoint:
    """Target position and finger opening, to be held for at least `steps` steps."""

    y: float
    z: float
    opening: float
    within_m: tuple[float, float] = (_FINE_M, _FINE_M)
    steps: int = 1


class BlocksExpert:
    """Picks up each named block and places it elsewhere, or at the goal if there is one, using the true state.

    Without skills it moves every block on show that the task has a skill for. Without a goal a block goes to a free
    place on the table, or onto a block that will not be moved any more.

    Raises:
        InvalidInput: A named block is hidden.
    """

    def __init__(self, world: BlocksWorld, skills: Sequence[str], rng: np.random.Generator) -> None:
        self._world = world
        self._waiting = deque(_named_on_show(world, skills))
        self._rng = rng
        self._speed = world.variation.speed * rng.uniform(*_SPEED)
        self._max_reach_steps = round(_MAX_REACH_STEPS / min(world.variation.speed, 1.0))
        self._waypoints: deque[_Waypoint] = deque()
        self._steps = 0
        self._colour = ""
        self._place: Position = np.zeros(3)
        self._tries = 0
        self._failed = False

    def act(self) -> LabelledAction | None:
        """Returns the next action of the current skill."""
        while not self._waypoints or self._is_reached():
            self._steps = 0
            if self._waypoints:
                self._waypoints.popleft()
            if not self._waypoints and not self._plan():
                return None
        self._steps += 1
        skill = self._world.spec.skills.index(f"move-{self._colour}")
        return LabelledAction(self._towards(self._waypoints[0]), skill)

    def succeeded(self) -> bool:
        """Returns whether every named block was placed."""
        done = not (self._failed or self._waiting or self._waypoints)
        return done and (not self._colour or self._is_placed())

    def _is_reached(self) -> bool:
        waypoint = self._waypoints[0]
        offset = np.abs(self._world.gripper - (waypoint.y, waypoint.z))
        return self._steps >= waypoint.steps and (
            bool((offset < waypoint.within_m).all()) or self._steps > self._max_reach_steps
        )

    def _is_placed(self) -> bool:
        offset = np.abs(self._world.position(self._colour) - self._place)
        return bool((offset < _PLACED_M).all() and offset[2] < _PLACED_M / 2)

    def _plan(self) -> bool:
        """Plans the next skill, or a retry of the current one; returns False when all are done."""
        if self._colour and not self._is_placed():
            self._tries += 1
            self._failed = self._tries >= _MAX_TRIES
        elif self._waiting:
            self._colour = self._waiting.popleft()
            self._tries = 0
            self._choose_place()
        else:
            return False
        if not self._failed:
            self._waypoints.extend(self._movements())
        return not self._failed

    def _movements(self) -> Iterable[_Waypoint]:
        block = self._world.position(self._colour)
        others = [self._world.position(colour) for colour in self._others()]
        over = max([block[2], *(other[2] for other in others)]) + BLOCK_M / 2 + _OVER_M
        y, z = float(block[1]), float(block[2]) + _GRASP_ABOVE_M
        to_y, to_z = float(self._place[1]), float(self._place[2]) + _GRASP_ABOVE_M + 0.002
        closing, opening = int(self._rng.integers(2, 4)), int(self._rng.integers(2, 4))
        start_y, start_z = (float(part) for part in self._world.gripper)
        return (
            _Waypoint(start_y, max(start_z, over), _RELEASE_M, within_m=_ROUGHLY, steps=0),
            _Waypoint(y, over, _OPEN_M, within_m=_ALIGNED),
            _Waypoint(y, z, _OPEN_M),
            _Waypoint(y, z, _CLOSED_M, within_m=_ROUGHLY, steps=closing),
            _Waypoint(y, over, _CLOSED_M, within_m=_ROUGHLY),
            _Waypoint(to_y, over, _CLOSED_M, within_m=_ALIGNED),
            _Waypoint(to_y, to_z, _CLOSED_M),
            _Waypoint(to_y, to_z, _RELEASE_M, within_m=_ROUGHLY, steps=opening),
            _Waypoint(to_y, to_z + _RETREAT_M, _RELEASE_M, within_m=_ROUGHLY),
        )

    def _others(self) -> list[str]:
        return [colour for colour in self._world.visible_colours if colour != self._colour]

    def _choose_place(self) -> None:
        """Chooses the target place; fails where there is none."""
        if self._world.goal is not None:
            self._place = self._goal_place(self._world.goal)
            return
        stacks, frees = self._tops(), self._free_places()
        stacking = bool(stacks) and (not frees or self._rng.random() < _STACK_PROBABILITY)
        places = stacks if stacking else frees
        self._failed = not places
        if places:
            self._place = places[int(self._rng.integers(len(places)))]

    def _goal_place(self, goal: BlockGoal) -> Position:
        other = self._world.position(goal.second)
        if goal.relation is BlockRelation.ON_TOP_OF:
            return np.add(other, (0, 0, BLOCK_M))
        side = -1 if goal.relation is BlockRelation.LEFT_OF else 1
        return np.add(other, (0, side * PLACED_ASIDE_M, 0))

    def _tops(self) -> list[Position]:
        """Returns the places on top of uncovered blocks on the table that will not be moved any more."""
        here = self._world.position(self._colour)
        positions = {colour: self._world.position(colour) for colour in self._others()}
        return [
            np.add(at, (0, 0, BLOCK_M))
            for colour, at in positions.items()
            if colour not in self._waiting
            and is_on_table(at)
            and not any(is_on(other, at) for other in (*positions.values(), here))
        ]

    def _free_places(self) -> list[Position]:
        """Returns the free places on the table, on a fine grid, away from the block's own place."""
        here = self._world.position(self._colour)[1]
        taken = np.array([self._world.position(colour)[1] for colour in self._others()])
        free = (np.abs(_LINE_M[:, None] - taken) > _FREE_M).all(axis=1) & (np.abs(_LINE_M - here) > _NEARBY_M)
        return [np.array([0, y, BLOCK_M / 2]) for y in _LINE_M[free]]

    def _towards(self, waypoint: _Waypoint) -> npt.NDArray[np.float32]:
        if self._rng.random() < _PAUSE_PROBABILITY:
            return np.zeros(3, np.float32)
        scale = np.array(self._world.spec.action.scale)
        way = (np.array([waypoint.y, waypoint.z, waypoint.opening]) - self._world.set_point) / scale
        furthest = float(np.abs(way[:2]).max())
        way[:2] *= min(1.0, self._speed / max(furthest, 1e-9))
        way[:2] += _NOISE * min(1.0, furthest) * self._rng.standard_normal(2)
        return np.asarray(np.clip(way, -1, 1), np.float32)


def _named_on_show(world: BlocksWorld, skills: Sequence[str]) -> Sequence[str]:
    """Returns the colours that skills name, those of all skills whose blocks are on show without any."""
    on_show = world.visible_colours
    if hidden := set(world.named(skills)).difference(on_show):
        raise InvalidInput(
            f"A recipe must name blocks on show, {', '.join(on_show)}; {', '.join(sorted(hidden))} is hidden.",
            field="skills",
            hint="Leave the recipe out for all blocks on show.",
        )
    return world.named(skills) or [colour for colour in world.named(world.spec.skills) if colour in on_show]
