"""Policies that act at random: uniformly, or smoothly, as the sim service's random behaviour."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from freerein.types.common import ActionSpec
from freerein_orchestrator.envs.policies import PolicyHandle, PolicyOutput
from freerein_orchestrator.rl.vec_env import Actions, Frames

_MEAN_HOLD_STEPS, _SMOOTHING, _EXTREME_PROBABILITY = 6.0, 0.5, 0.3


def uniform_policy(action: ActionSpec) -> PolicyHandle:
    """Returns the policy of uniform actions: in [-1, 1], or among all choices."""
    return PolicyHandle(
        lambda session: _UniformPolicy(action, np.random.default_rng(session.seed)), {"policy": "random"}
    )


def exploration_policy(action: ActionSpec, *, stream: int = 0) -> PolicyHandle:
    """Returns the policy of smooth random actions, with the parameters of the sim service's random behaviour.

    Policies of different `stream` act differently in sessions of one seed.
    """
    return PolicyHandle(
        lambda session: _SmoothPolicy(action, np.random.default_rng((session.seed, stream))),
        {"policy": "exploration"},
    )


class _UniformPolicy:
    """Uniform actions."""

    def __init__(self, action: ActionSpec, rng: np.random.Generator) -> None:
        self._action = action
        self._rng = rng

    def act(self, _frames: Mapping[str, Frames], episode_starts: npt.NDArray[np.bool_]) -> PolicyOutput:
        return PolicyOutput(_uniform(self._action, len(episode_starts), self._rng))


class _SmoothPolicy:
    """Approaches a random target for a random number of steps, then draws the next; discrete actions are repeated."""

    def __init__(self, action: ActionSpec, rng: np.random.Generator) -> None:
        self._spec = action
        self._rng = rng
        self._hold_steps = np.zeros((0, action.size), np.int64)

    def act(self, _frames: Mapping[str, Frames], episode_starts: npt.NDArray[np.bool_]) -> PolicyOutput:
        if not len(self._hold_steps):
            self._hold_steps = np.zeros((len(episode_starts), self._spec.size), np.int64)
            self._target = self._action = np.zeros(self._hold_steps.shape)
        self._hold_steps = self._hold_steps - 1
        is_new, shape = self._hold_steps < 0, self._hold_steps.shape
        self._target = np.where(is_new, self._draw(len(episode_starts)), self._target)
        self._hold_steps = np.where(is_new, self._rng.geometric(1 / _MEAN_HOLD_STEPS, shape), self._hold_steps)
        if self._spec.choices:
            return PolicyOutput(self._target.astype(np.int64))
        self._action = self._action + _SMOOTHING * (self._target - self._action)
        return PolicyOutput(self._action.astype(np.float32))

    def _draw(self, count: int) -> Actions:
        drawn = _uniform(self._spec, count, self._rng)
        if self._spec.choices:
            return drawn
        extreme = self._rng.random(drawn.shape) < _EXTREME_PROBABILITY
        return np.where(extreme, self._rng.choice((-1.0, 1.0), drawn.shape), drawn).astype(np.float32)


def _uniform(action: ActionSpec, count: int, rng: np.random.Generator) -> Actions:
    shape = count, action.size
    return rng.integers(action.choices, size=shape) if action.choices else rng.uniform(-1, 1, shape).astype(np.float32)
