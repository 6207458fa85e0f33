"""The scripted expert of the rope world: ties an overhand knot, or lays the rope down as an S.

It looks at the true points of the rope before each action.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from freerein_sim.worlds.recipes import check_one
from freerein_sim.worlds.rope.knot_moves import knot_moves
from freerein_sim.worlds.rope.moves import Move, RopeView, curve_of, lay_down
from freerein_sim.worlds.rope.predicates import SHAPES
from freerein_sim.worlds.rope.simulation import RopeWorld
from freerein_sim.worlds.rope.spec import KNOT, LINKS, LONGEST_M, SPEC
from freerein_sim.worlds.world import LabelledAction, skill_indices

_S_RAD = 1.15 * np.pi * np.interp(np.arange(LINKS), (0, LINKS // 2, LINKS - 1), (0, 1, 0))
"""Headings of the links of an S: two arcs, of more than half a circle, because the rope springs back."""

_S_TOLERANCE_M, _S_MOVES = 0.02, 30


class RopeExpert:
    """Executes a skill; without one that of the episode, or one that it draws. It draws which end it begins with."""

    def __init__(self, world: RopeWorld, skills: Sequence[str], rng: np.random.Generator) -> None:
        check_one(skills, begin="with the rope in any curve")
        skill = (tuple(skills) or world.recipe or (str(rng.choice(SPEC.skills)),))[0]
        (self._skill,) = skill_indices(SPEC, [skill])
        self._has_shape = SHAPES[skill]
        self._world = world
        self._rope = RopeView(world, is_reversed=bool(rng.integers(2)))
        self._moves = self._plan(skill, rng)

    def act(self) -> LabelledAction | None:
        """Returns the next action; None at the end of the plan."""
        move = next(self._moves, None)
        if move is None:
            return None
        pick = self._rope.middles[move.link]
        way = move.place - pick
        way *= min(1.0, LONGEST_M / max(float(np.linalg.norm(way)), 1e-9))
        action = np.concatenate([pick, way]) / SPEC.action.scale
        return LabelledAction(np.clip(action, -1, 1).astype(np.float32), self._skill)

    def succeeded(self) -> bool:
        """Returns whether the rope has the shape of the skill."""
        return self._has_shape(self._world.points)

    def _plan(self, skill: str, rng: np.random.Generator) -> Iterator[Move]:
        if skill == KNOT:
            return knot_moves(self._rope, is_mirrored=bool(rng.integers(2)), rng=rng)
        curve = curve_of(_S_RAD, self._rope)
        return lay_down(self._rope, curve, tolerance_m=_S_TOLERANCE_M, most=_S_MOVES)
