"""The scripted expert of the push world: goes behind one puck and pushes it close to the other."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.push.criteria import CLOSE_M, Place
from freerein_sim.worlds.push.predicates import is_behind
from freerein_sim.worlds.push.simulation import PushWorld
from freerein_sim.worlds.push.spec import RECIPE
from freerein_sim.worlds.push.things import OBJECT_M
from freerein_sim.worlds.world import LabelledAction, skill_indices

_BEHIND_M = 0.06
"""Distance from the puck's centre at which the hand stands behind it."""

_ROOM_M = 0.053
"""Distance from a puck's centre within which the hand would touch it."""

_CLOSE_M = CLOSE_M - 0.008
_BEGIN_M = 0.008
_PUSHED_STEP = 0.5
"""Greatest speed of a push, as a share of the greatest one."""

_STEERING = 1.2
_SPEED = (0.7, 1.0)
_NOISE = 0.06
_PAUSE_PROBABILITY = 0.02
_LEFT, _RIGHT = np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([[0.0, 1.0], [-1.0, 0.0]])
"""Quarter turns."""

Way = npt.NDArray[np.float64]
"""float64 (2,): x and y in metres."""


class PushExpert:
    """Pushes the world's first thing towards its second, using the true state, until they are close.

    It looks anew before each action. Where the puck has slipped aside, it goes around it again; that still belongs to
    the skill `push`.
    """

    def __init__(self, world: PushWorld, skills: Sequence[str], rng: np.random.Generator) -> None:
        skill_indices(world.spec, skills)
        RECIPE.check(skills)
        self._world = world
        self._rng = rng
        self._speed = rng.uniform(*_SPEED)
        self._is_pushing = False
        self._skill = 0

    def act(self) -> LabelledAction | None:
        """Returns the next action of the current skill."""
        hand, first, second = self._places()
        if self.succeeded():
            return None
        self._is_pushing = bool(is_behind(hand, first, second)) and (self._is_pushing or self._stands_behind())
        self._skill = max(self._skill, int(self._is_pushing))
        way = self._push() if self._is_pushing else self._approach()
        return LabelledAction(self._noisy(way), self._skill)

    def succeeded(self) -> bool:
        """Returns whether the pucks are close, with a margin."""
        _, first, second = self._places()
        return bool(np.linalg.norm(second - first) < _CLOSE_M)

    def _places(self) -> tuple[Place, Place, Place]:
        world = self._world
        return world.hand, world.place(world.things[0]), world.place(world.things[1])

    def _ahead(self) -> Way:
        """Returns the direction from the first puck to the second."""
        _, first, second = self._places()
        ahead = (second - first)[:2]
        return np.asarray(ahead / np.linalg.norm(ahead))

    def _behind(self) -> Way:
        """Returns where the hand begins to push."""
        _, first, _ = self._places()
        return np.asarray(first[:2] - _BEHIND_M * self._ahead())

    def _stands_behind(self) -> bool:
        return bool(np.linalg.norm(self._world.hand[:2] - self._behind()) < _BEGIN_M)

    def _push(self) -> Way:
        """Returns the way on, and aside towards the line through both pucks."""
        hand, first, _ = self._places()
        ahead = self._ahead()
        aside = (hand - first)[:2] @ (_LEFT @ ahead)
        step = _PUSHED_STEP * self._world.spec.action.scale[0]
        return np.asarray(step * ahead - _STEERING * aside * (_LEFT @ ahead))

    def _approach(self) -> Way:
        """Returns the way to where the push begins, around the pucks."""
        hand, first, second = (place[:2] for place in self._places())
        way = self._behind() - hand
        for puck in sorted((first, second), key=lambda each: float(np.linalg.norm(each - hand))):
            way = _around(way, puck - hand)
        return way

    def _noisy(self, way: Way) -> npt.NDArray[np.float32]:
        """Returns the action of a way: its direction, and its length up to the speed of this demonstration."""
        if self._rng.random() < _PAUSE_PROBABILITY:
            return np.zeros(2, np.float32)
        action = (self._world.hand[:2] + way - self._world.set_point) / np.array(self._world.spec.action.scale)
        furthest = float(np.abs(action).max())
        action *= min(1.0, self._speed / max(furthest, 1e-9))
        action += _NOISE * min(1.0, furthest) * self._rng.standard_normal(2)
        return np.asarray(np.clip(action, -1, 1), np.float32)


def _around(way: Way, puck: Way) -> Way:
    """Returns a way that does not touch a puck, both as seen from the hand: itself, or one along a tangent."""
    distance = float(np.linalg.norm(puck))
    along = float(way @ puck) / max(float(way @ way), 1e-12)
    nearest = np.linalg.norm(puck - np.clip(along, 0, 1) * way)
    if nearest >= _ROOM_M or along <= 0:
        return way
    towards = puck / distance
    turn = _LEFT if way @ (_LEFT @ towards) > 0 else _RIGHT
    sine = min(1.0, _ROOM_M / distance)
    outwards = min(0.0, distance - _ROOM_M) * towards
    tangent = np.sqrt(1 - sine**2) * towards + sine * (turn @ towards)
    return np.asarray(OBJECT_M * tangent + outwards)
