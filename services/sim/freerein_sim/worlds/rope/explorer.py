"""Self-supervised exploration of the rope world, as in the dissertation: a random point of the rope is displaced."""

import numpy as np

from freerein_sim.worlds.rope.simulation import RopeWorld
from freerein_sim.worlds.rope.spec import LINKS, LONGEST_M, SPEC
from freerein_sim.worlds.world import NO_SKILL, LabelledAction

_SHORTEST_M = 0.01
_INSIDE_M = 0.24
"""Greatest distance of a place from the middle of the table, along x and y, so that the rope stays in view."""


class RandomDisplacements:
    """Picks a random link of the rope, and displaces it in a random direction by 1 to 15 cm. It never finishes."""

    def __init__(self, world: RopeWorld, rng: np.random.Generator) -> None:
        self._world = world
        self._rng = rng

    def act(self) -> LabelledAction:
        """Returns the next action, without a skill."""
        points = self._world.points[:, :2]
        link = int(self._rng.integers(LINKS))
        pick = np.clip((points[link] + points[link + 1]) / 2, -SPEC.action.scale[0], SPEC.action.scale[0])
        direction, length = self._rng.uniform(-np.pi, np.pi), self._rng.uniform(_SHORTEST_M, LONGEST_M)
        place = np.clip(pick + length * np.array([np.cos(direction), np.sin(direction)]), -_INSIDE_M, _INSIDE_M)
        way = np.clip(place - pick, -LONGEST_M, LONGEST_M)
        return LabelledAction((np.concatenate([pick, way]) / SPEC.action.scale).astype(np.float32), NO_SKILL)

    def succeeded(self) -> bool:
        """Returns True."""
        return True
