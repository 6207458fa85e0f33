"""One of our worlds as a Gymnasium environment: what somebody would write who has Gymnasium and no sim service."""

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from freerein.types.common import ActionSpec
from freerein_sim.worlds.world import Frame, TaskDefinition


class WorldEnv(gymnasium.Env[Frame, npt.NDArray[Any]]):
    """One environment.

    Args:
        task: The task.
        cameras: The camera to observe, or none: an observation is uint8 (H, W, C), or (0,).
        seed: Seeds its generator.
    """

    def __init__(self, task: TaskDefinition, cameras: tuple[str, ...], *, seed: np.random.SeedSequence) -> None:
        self._world = task.make()
        self._longest_steps = task.spec.max_episode_steps
        self._camera = next((camera for camera in task.spec.cameras if camera.name in cameras), None)
        self._rng = np.random.default_rng(seed)
        self._steps = 0
        shape = (0,) if self._camera is None else (self._camera.height, self._camera.width, self._camera.channels)
        self.observation_space = spaces.Box(0, 255, shape, np.uint8)
        self.action_space = _action_space(task.spec.action)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Frame, dict[str, Any]]:
        """Begins an episode; the generator goes on."""
        self._world.reset(self._rng)
        self._steps = 0
        return self._observe(), {}

    def step(self, action: npt.NDArray[Any]) -> tuple[Frame, float, bool, bool, dict[str, Any]]:
        """Takes one action."""
        outcome = self._world.step(action)
        self._steps += 1
        return self._observe(), 0.0, outcome.terminated, self._steps >= self._longest_steps, {}

    def close(self) -> None:
        """Frees the world."""
        self._world.close()

    def _observe(self) -> Frame:
        if self._camera is None:
            return np.empty(0, np.uint8)
        return self._world.render(self._camera.name, height=self._camera.height, width=self._camera.width)


def _action_space(action: ActionSpec) -> spaces.Space[npt.NDArray[Any]]:
    if action.choices:
        return spaces.MultiDiscrete([action.choices] * action.size)
    return spaces.Box(-1.0, 1.0, (action.size,), np.float32)
