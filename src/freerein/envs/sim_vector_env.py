"""A Gymnasium vector environment over the sim service: many environments of one session, stepped by one call."""

from typing import Any, Unpack

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from freerein.envs.env_session import ADDRESS, EnvSession, Observation, Pixels, SessionOptions, frames_of
from freerein.envs.sim_env import METADATA, reset_info, rewards_of, step_info
from freerein.errors import must_be
from freerein.types.sim import CameraFrames, StepResponse

_MODES = (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP)
Flags = npt.NDArray[np.bool_]
Step = tuple[Observation, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]


class SimVectorEnv(gymnasium.vector.VectorEnv[Observation, Any, npt.NDArray[Any]]):
    """`num_envs` environments of one session, stepped by one call.

    With SAME_STEP, where an episode ends, the observation is the first of the next episode, and `info["final_obs"]` and
    `info["final_info"]` hold the last of the old one. With NEXT_STEP it is the last of the old one; the next step
    ignores the action, and returns the first of the next episode and a reward of 0. Unless all environments end
    together, that takes a second call, and the episode that the service had begun is left for another.

    `render()` returns a tuple with a frame of each environment.

    Args:
        task: Task name.
        address: `host:port` of the sim service; by default its port on this machine.
        num_envs: N.
        autoreset_mode: SAME_STEP or NEXT_STEP, or its value.
        max_episode_steps: Steps after which an episode is truncated, for `gymnasium.make_vec`; None or -1 for the
            task's own.
        options: See `SessionOptions`.

    Raises:
        InvalidInput: There is no such option, mode or limit.
        ServiceError: As every method: the service refused, was unreachable or did not answer in time.
    """

    metadata = METADATA | {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self,
        task: str,
        address: str = ADDRESS,
        *,
        num_envs: int,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        max_episode_steps: int | None = None,
        **options: Unpack[SessionOptions],
    ) -> None:
        self._mode = _mode(autoreset_mode)
        if max_episode_steps not in (None, -1):
            options["episode_timesteps"] = _timesteps(max_episode_steps, options)
        self._session = EnvSession(task, address, num_envs=num_envs, **options)
        self.task = self._session.task
        self.cameras = self._session.cameras
        self.num_envs = num_envs
        self.render_mode = options.get("render_mode")
        self.metadata = type(self).metadata | self._session.metadata | {"autoreset_mode": self._mode}
        self.single_observation_space = self._session.observation_space
        self.single_action_space = self._session.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._latest: CameraFrames | None = None  # what is observed
        self._begun: CameraFrames = {}  # the same, but of environments that reset in the next step their first frames
        self._resets_next = np.zeros(num_envs, np.bool_)
        self._made: tuple[npt.NDArray[Any], StepResponse] | None = None  # a step whose second call, a reset, failed

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins episodes in all environments, or where `options["reset_mask"]`, bool (N,), is true.

        Args:
            seed: Environment i draws from `SeedSequence(seed).spawn(N)[i]`; None keeps the generators.
            options: None, or `{"reset_mask": mask}`.

        Returns:
            Observations; info, as of `SimEnv.reset`. With `info["new_session"]`, bool (N,), all environments begin.
        """
        super().reset(seed=seed)
        envs = _masked(options["reset_mask"], self.num_envs) if options and "reset_mask" in options else ()
        self._made = None
        reply = self._session.begin(seed=seed, envs=envs)
        is_new = self._session.is_new
        begun = range(self.num_envs) if is_new or not envs else envs
        self._resets_next[list(begun)] = False
        self._latest = _with_rows(reply.frames, self._latest, self._resets_next)
        self._begun = reply.frames
        info: dict[str, Any] = {}
        for index in begun:
            info = self._add_info(info, reset_info(reply.truth, index, is_new_session=is_new), index)
        return self._session.observation(self._latest), info

    def step(self, actions: npt.ArrayLike) -> Step:
        """Takes one action in each environment: float32 (N, A) in [-1, 1], or discrete choices (N,).

        Where only the second call of a step failed, a step of the same actions repeats that call alone.

        Returns:
            Observations; rewards, float64 (N,); terminated and truncated, bool (N,); info, with `diverged` bool (N,).
        """
        if self._mode is AutoresetMode.SAME_STEP:
            return self._step_and_reset(self._session.step(actions))
        if self._resets_next.all():
            return self._begin_all()
        nothing = self._resets_next.reshape(-1, *[1] * (np.ndim(actions) - 1))
        taken = np.where(nothing, 0, actions)
        made, self._made = self._made, None
        if made is None or not np.array_equal(made[0], taken):
            made = taken, self._session.step(taken)
        self._made = made
        step, self._made = self._step_or_reset(made[1]), None
        return step

    def _step_and_reset(self, reply: StepResponse) -> Step:
        """Returns a step in which environments reset where their episodes end."""
        self._latest = reply.frames
        info: dict[str, Any] = {}
        ended = 0
        for index in range(self.num_envs):
            step = step_info(reply, index)
            if reply.terminated[index] or reply.truncated[index]:
                final = self._session.observation(frames_of(reply.final_frames, ended))
                info = self._add_info(info, {"final_obs": final, "final_info": step}, index)
                step, ended = reset_info(None, index, is_new_session=False), ended + 1
            info = self._add_info(info, step, index)
        observations = self._session.observation(reply.frames)
        return observations, rewards_of(reply), reply.terminated.copy(), reply.truncated.copy(), info

    def _step_or_reset(self, reply: StepResponse) -> Step:
        """Returns a step of the environments whose episodes go on; the others reset."""
        resets, infos = self._resets_next, [step_info(reply, index) for index in range(self.num_envs)]
        frames = reply.frames
        if resets.any():
            envs = tuple(np.flatnonzero(resets).tolist())
            begun = self._session.reset(seed=None, envs=envs)
            frames = begun.frames
            for index in envs:
                infos[index] = reset_info(begun.truth, index, is_new_session=False)
        terminated, truncated = reply.terminated & ~resets, reply.truncated & ~resets
        self._begun, self._resets_next = frames, terminated | truncated
        self._latest = _with_finals(frames, reply, self._resets_next)
        rewards = np.where(resets, 0.0, rewards_of(reply))
        return self._session.observation(self._latest), rewards, terminated, truncated, self._joined(infos)

    def _begin_all(self) -> Step:
        """Returns the step in which all environments reset: the service did it when their episodes ended."""
        self._latest, self._resets_next = self._begun, np.zeros(self.num_envs, np.bool_)
        infos = [reset_info(None, index, is_new_session=False) for index in range(self.num_envs)]
        no = np.zeros(self.num_envs, np.bool_)
        return self._session.observation(self._begun), np.zeros(self.num_envs), no, no.copy(), self._joined(infos)

    def _joined(self, infos: list[dict[str, Any]]) -> dict[str, Any]:
        joined: dict[str, Any] = {}
        for index, info in enumerate(infos):
            joined = self._add_info(joined, info, index)
        return joined

    def render(self) -> tuple[Pixels, ...] | None:
        """Returns each environment's latest frame of the first camera, uint8 (H, W, 3); None without a render mode."""
        return tuple(self._session.rgb_frames(self._latest)) if self.render_mode else None

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the session; called by `close`."""
        self._session.close()


def _with_rows(frames: CameraFrames, kept: CameraFrames | None, rows: Flags) -> CameraFrames:
    """Returns frames by camera, (N, H, W, C) each, with some rows of others."""
    if kept is None or not rows.any():
        return frames
    return {camera: np.where(rows[:, None, None, None], kept[camera], each) for camera, each in frames.items()}


def _with_finals(frames: CameraFrames, reply: StepResponse, rows: Flags) -> CameraFrames:
    """Returns frames by camera, with the last ones of episodes that ended in some rows."""
    finals = {camera: np.array(each) for camera, each in frames.items()}
    for place, index in enumerate(np.flatnonzero(reply.terminated | reply.truncated)):
        if rows[index]:
            for camera, each in finals.items():
                each[index] = reply.final_frames[camera][place]
    return finals


def _mode(mode: object) -> AutoresetMode:
    found = next((each for each in _MODES if mode in (each, each.value, each.name)), None)
    if found is None:
        hint = "Leave it out for SAME_STEP, by which a step needs one call."
        raise must_be("autoreset_mode", " or ".join(each.name for each in _MODES), "another one", hint=hint)
    return found


def _timesteps(steps: object, options: SessionOptions) -> int:
    """Returns the timesteps of an episode of so many steps."""
    if "episode_timesteps" in options or not isinstance(steps, int) or steps < 1:
        rule = "at least 1 step, without `episode_timesteps` beside it"
        raise must_be("max_episode_steps", rule, "something else", hint="Leave one of them out.")
    return steps * options.get("action_repeat", 1)


def _masked(mask: npt.ArrayLike, num_envs: int) -> tuple[int, ...]:
    """Returns the indices where a reset mask is true."""
    array = np.asarray(mask)
    if array.shape != (num_envs,) or array.dtype != np.bool_ or not array.any():
        rule, got = f"bool ({num_envs},) with a true value", f"{array.dtype} {array.shape}"
        raise must_be("reset_mask", rule, got, hint="Leave it out to reset all environments.")
    return tuple(int(index) for index in np.flatnonzero(array))
