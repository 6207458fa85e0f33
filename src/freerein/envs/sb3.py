"""Gymnasium vector environments for Stable-Baselines3 (extra `sb3`), which has an interface of its own for them."""

try:
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvObs, VecEnvStepReturn
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "freerein.envs.sb3 needs stable-baselines3, which is not installed: pip install 'freerein[sb3]'",
        name=error.name,
    ) from error

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import VectorEnv
from gymnasium.wrappers.vector import DictInfoToList

from freerein.envs.autoreset import check_same_step
from freerein.envs.enlarged_frames import enlarged, enlarged_space, enlargement
from freerein.envs.env_session import Observation

_NO_SINGLE_ENVIRONMENTS = "The environments of a vector step together: no single one has methods or attributes to set."


class SB3VecEnv(VecEnv):
    """A Gymnasium vector environment as Stable-Baselines3's `VecEnv`.

    Put Stable-Baselines3's `VecMonitor` around it for the statistics of episodes.

    Args:
        envs: Reset in the step that ends an episode (`AutoresetMode.SAME_STEP`).
        render_size: Least height and width of frames, in pixels: smaller ones are enlarged by a whole factor.
            Stable-Baselines3's `CnnPolicy` needs 36. 0 leaves them as they are.

    Raises:
        InvalidInput: They reset in another one.
    """

    def __init__(self, envs: VectorEnv[Observation, Any, npt.NDArray[Any]], *, render_size: int = 0) -> None:
        check_same_step(envs)
        self._envs = DictInfoToList(envs)
        single = envs.single_observation_space
        parts = single.items() if isinstance(single, spaces.Dict) else [("", single)]
        self._factors = {name: enlargement(part, render_size) for name, part in parts}
        space = enlarged_space(single, render_size)  # a copy: `VecNormalize` changes its own
        super().__init__(envs.num_envs, space, deepcopy(envs.single_action_space))
        self.metadata = envs.metadata | self.metadata

    def reset(self) -> VecEnvObs:
        """Begins episodes; after `seed(s)`, environment i draws from `SeedSequence(s).spawn(N)[i]`."""
        observations, self.reset_infos = self._envs.reset(seed=self._seeds[0], options=self._options[0] or None)
        self._reset_seeds()
        self._reset_options()
        return self._enlarged(observations)

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Notes the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Takes the actions; returns observations, rewards, whether episodes ended, and infos."""
        observations, rewards, terminated, truncated, infos = self._envs.step(self._actions)
        ended = terminated | truncated
        for index, info in enumerate(infos):
            if ended[index]:
                last, final_info = info.pop("final_obs"), info.pop("final_info")
                self.reset_infos[index] = dict(info)
                info.update(final_info, terminal_observation=self._enlarged(last))
            info["TimeLimit.truncated"] = bool(truncated[index] and not terminated[index])
        return self._enlarged(observations), rewards.astype(np.float32), ended, infos

    def _enlarged(self, observations: Observation) -> VecEnvObs:
        """Returns observations, (..., H, W, C) or a dict of them, as large as the space says."""
        if isinstance(observations, dict):
            return {name: enlarged(each, self._factors[name]) for name, each in observations.items()}
        return enlarged(observations, self._factors[""])

    def close(self) -> None:
        """Closes the environments."""
        self._envs.close()

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """Returns each environment's frame, uint8 (H, W, 3); None without a render mode."""
        frames: Any = self._envs.render()
        return [None] * self.num_envs if frames is None else list(frames)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Returns an attribute of the vector, once for each environment."""
        owner = self._envs if hasattr(self._envs, attr_name) else self._envs.unwrapped
        return [getattr(owner, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raises NotImplementedError: a vector has no single environments."""
        raise NotImplementedError(_NO_SINGLE_ENVIRONMENTS)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Raises NotImplementedError: a vector has no single environments."""
        raise NotImplementedError(_NO_SINGLE_ENVIRONMENTS)

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """Returns False for each environment: a vector has no single environments to wrap."""
        return [False] * len(list(self._get_indices(indices)))
