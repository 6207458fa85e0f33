"""A temporally smooth random policy, for self-supervised exploration data."""

import numpy as np

from freerein.types.common import ActionSpec
from freerein_sim.worlds.world import NO_SKILL, LabelledAction, ScriptedPolicy, TaskDefinition, World

_MEAN_HOLD_STEPS = 6.0
_SMOOTHING = 0.5
_EXTREME_PROBABILITY = 0.3


def explorer_of(task: TaskDefinition, world: World, rng: np.random.Generator) -> ScriptedPolicy:
    """Returns what explores in a world of a task: the task's own explorer, or smooth random actions."""
    return task.explorer(world, rng) if task.explorer else SmoothRandomPolicy(world.spec.action, rng)


class SmoothRandomPolicy:
    """Approaches a random target action for a random number of steps, then draws the next target.

    A continuous action moves halfway to its target each step; targets are often at a limit, so that grippers open and
    close fully and the whole workspace is visited. A discrete action is repeated. The policy never finishes.
    """

    def __init__(self, action: ActionSpec, rng: np.random.Generator) -> None:
        self._spec = action
        self._rng = rng
        self._target = np.zeros(action.size)
        self._action = np.zeros(action.size)
        self._hold_steps = np.zeros(action.size, np.int64)

    def act(self) -> LabelledAction:
        """Returns the next action, without a skill."""
        self._hold_steps -= 1
        for i in np.flatnonzero(self._hold_steps < 0):
            self._hold_steps[i] = self._rng.geometric(1 / _MEAN_HOLD_STEPS)
            self._target[i] = self._draw()
        if self._spec.choices:
            return LabelledAction(self._target.astype(np.int64), NO_SKILL)
        self._action += _SMOOTHING * (self._target - self._action)
        return LabelledAction(self._action.astype(np.float32), NO_SKILL)

    def succeeded(self) -> bool:
        """Returns True."""
        return True

    def _draw(self) -> float:
        if self._spec.choices:
            return float(self._rng.integers(self._spec.choices))
        if self._rng.random() < _EXTREME_PROBABILITY:
            return float(self._rng.choice((-1.0, 1.0)))
        return float(self._rng.uniform(-1, 1))
