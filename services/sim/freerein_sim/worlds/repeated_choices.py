"""Exploration by repeated choices: draws a choice, and for how many steps it is repeated."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from freerein.types.common import ActionSpec
from freerein_sim.worlds.world import NO_SKILL, LabelledAction, UnsavedWorld


@dataclass(frozen=True)
class Repeats:
    """How often a choice is drawn, and for how many steps at most it is repeated; their number is drawn uniformly."""

    probability: float
    most_steps: int


class RepeatedChoices:
    """Repeats random choices. It never finishes.

    Args:
        repeats: Of each choice; the probabilities add up to 1.
        action: The action space, discrete, with as many choices.
        rng: Draws the choices.
    """

    def __init__(self, repeats: Sequence[Repeats], action: ActionSpec, rng: np.random.Generator) -> None:
        if len(repeats) != action.choices:
            raise ValueError(f"There must be repeats of each of {action.choices} choices; got {len(repeats)}.")
        self._repeats = repeats
        self._rng = rng
        self._choice = self._left = 0

    def act(self) -> LabelledAction:
        """Returns the next action, without a skill."""
        if not self._left:
            weights = [each.probability for each in self._repeats]
            self._choice = int(self._rng.choice(len(weights), p=weights))
            self._left = int(self._rng.integers(1, self._repeats[self._choice].most_steps, endpoint=True))
        self._left -= 1
        return LabelledAction(np.array([self._choice], np.int64), NO_SKILL)

    def succeeded(self) -> bool:
        """Returns True."""
        return True


def repeat_choices(repeats: Sequence[Repeats], world: UnsavedWorld, rng: np.random.Generator) -> RepeatedChoices:
    """Returns an explorer of a world; see `RepeatedChoices`."""
    return RepeatedChoices(repeats, world.spec.action, rng)
