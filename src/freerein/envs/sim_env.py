"""Gymnasium environments over the sim service, with images as the only observations.

An observation is a camera's frame, uint8 (H, W, C), or a dict of frames for several cameras. The reward is 0.0, since
rewards come from reward models.

Every step is a unary call rather than a message on the stream `Connect`: up to 0.3 ms slower (1.3 instead of 1.0 ms for
one small world), but with a deadline and with retries, which `step_id` makes safe.
"""

from typing import Any, Unpack

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from freerein.envs.env_session import ADDRESS, EnvSession, Observation, Pixels, SessionOptions, frames_of, truth_info
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.types.sim import CameraFrames, StepResponse

_METADATA: dict[str, Any] = {"render_modes": ["rgb_array"]}


class SimEnv(gymnasium.Env[Observation, Any]):
    """One environment.

    The service resets in the step that ends an episode. That is hidden here: the step returns the last frame of the old
    episode, and `reset()` the first frame of the new one; `reset(seed=...)` begins another episode.

    Args:
        task: Task name.
        address: `host:port` of the sim service; by default its port on this machine.
        options: See `SessionOptions`.

    Raises:
        ServiceError: As every method: the service refused, was unreachable or did not answer in time.
    """

    metadata = _METADATA

    def __init__(self, task: str, address: str = ADDRESS, **options: Unpack[SessionOptions]) -> None:
        self._session = EnvSession(task, address, **options)
        self.task = self._session.task
        self.cameras = self._session.cameras
        self.render_mode = options.get("render_mode")
        self.metadata = self._session.metadata
        self.observation_space = self._session.observation_space
        self.action_space = self._session.action_space
        self._latest: dict[str, Pixels] | None = None
        self._begun: dict[str, Pixels] | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode; `options` are ignored."""
        super().reset(seed=seed)
        begun, info = self._begun, dict[str, Any]()
        if begun is None or seed is not None:
            reply = self._session.reset(seed=seed)
            begun, info = frames_of(reply.frames, 0), truth_info(reply.truth, 0)
        self._latest, self._begun = begun, None
        return self._session.observation(begun), info

    def step(self, action: npt.ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Takes one action: float32 (A,) in [-1, 1], or a discrete choice. `info["diverged"]`: the simulation diverged.

        Raises:
            FailedPrecondition: The episode has ended.
        """
        if self._begun is not None:
            raise FailedPrecondition("`step` needs a running episode; this one has ended.", hint="Call reset() first.")
        reply = self._session.step(np.asarray(action)[np.newaxis])
        terminated, truncated = bool(reply.terminated[0]), bool(reply.truncated[0])
        self._latest = frames_of(reply.frames, 0)
        if terminated or truncated:
            self._latest, self._begun = frames_of(reply.final_frames, 0), self._latest
        observation = self._session.observation(self._latest)
        return observation, float(_reward(reply)[0]), terminated, truncated, _step_info(reply, 0)

    def render(self) -> Pixels | None:
        """Returns the first camera's latest frame, uint8 (H, W, 3); None unless `render_mode` is `rgb_array`."""
        return self._session.rgb_frames(self._latest) if self.render_mode else None

    def close(self) -> None:
        """Closes the session; may be called twice."""
        self._session.close()


class SimVectorEnv(gymnasium.vector.VectorEnv[Observation, Any, npt.NDArray[Any]]):
    """`num_envs` environments of one session, stepped by one call.

    Autoreset is SAME_STEP: where an episode ends, the observation is the first of the next episode, and
    `info["final_obs"]` and `info["final_info"]` hold the last of the old one.

    The arguments are those of `SimEnv`, and `num_envs`, N. `info["truth"]` of an environment whose episode ended is in
    `final_info`; `render()` returns a tuple with a frame of each environment.

    Raises:
        ServiceError: As every method: the service refused, was unreachable or did not answer in time.
    """

    metadata = _METADATA | {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, task: str, address: str = ADDRESS, *, num_envs: int, **options: Unpack[SessionOptions]) -> None:
        self._session = EnvSession(task, address, num_envs=num_envs, **options)
        self.task = self._session.task
        self.cameras = self._session.cameras
        self.num_envs = num_envs
        self.render_mode = options.get("render_mode")
        self.metadata = type(self).metadata | self._session.metadata
        self.single_observation_space = self._session.observation_space
        self.single_action_space = self._session.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._latest: CameraFrames | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins episodes in all environments, or where `options["reset_mask"]`, bool (N,), is true.

        Args:
            seed: Environment i draws from `SeedSequence(seed).spawn(N)[i]`; None keeps the generators.
            options: None, or `{"reset_mask": mask}`.
        """
        super().reset(seed=seed)
        envs = _masked(options["reset_mask"], self.num_envs) if options and "reset_mask" in options else ()
        reply = self._session.reset(seed=seed, envs=envs)
        self._latest = reply.frames
        info: dict[str, Any] = {}
        for index in envs or range(self.num_envs):
            info = self._add_info(info, truth_info(reply.truth, index), index)
        return self._session.observation(reply.frames), info

    def step(
        self, actions: npt.ArrayLike
    ) -> tuple[Observation, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Takes one action in each environment: float32 (N, A) in [-1, 1], or discrete choices (N,).

        Returns:
            Observations; rewards, float64 (N,); terminated and truncated, bool (N,); info, with `diverged` bool (N,).
        """
        reply = self._session.step(actions)
        self._latest = reply.frames
        terminated, truncated = reply.terminated.copy(), reply.truncated.copy()
        info: dict[str, Any] = {}
        ended = 0
        for index in range(self.num_envs):
            step_info = _step_info(reply, index)
            if terminated[index] or truncated[index]:
                final = self._session.observation(frames_of(reply.final_frames, ended))
                step_info, ended = {"final_obs": final, "final_info": step_info}, ended + 1
            info = self._add_info(info, step_info, index)
        return self._session.observation(reply.frames), _reward(reply), terminated, truncated, info

    def render(self) -> tuple[Pixels, ...] | None:
        """Returns each environment's latest frame of the first camera, uint8 (H, W, 3); None without a render mode."""
        return tuple(self._session.rgb_frames(self._latest)) if self.render_mode else None

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the session; called by `close`."""
        self._session.close()


def _reward(reply: StepResponse) -> npt.NDArray[np.float64]:
    return np.array(reply.reward if reply.truth is None else reply.truth.reward, np.float64)


def _step_info(reply: StepResponse, index: int) -> dict[str, Any]:
    return {"diverged": bool(reply.diverged[index]), **truth_info(reply.truth, index)}


def _masked(mask: npt.ArrayLike, num_envs: int) -> tuple[int, ...]:
    """Returns the indices where a reset mask is true."""
    array = np.asarray(mask)
    if array.shape != (num_envs,) or array.dtype != np.bool_ or not array.any():
        raise InvalidInput(
            f"`reset_mask` must be bool ({num_envs},) with a true value; got {array.dtype} {array.shape}.",
            field="reset_mask",
            hint="Leave it out to reset all environments.",
        )
    return tuple(int(index) for index in np.flatnonzero(array))
