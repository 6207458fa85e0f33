"""A Gymnasium environment over the sim service, with images as the only observations.

An observation is a camera's frame, uint8 (H, W, C), or a dict of frames for several cameras. The reward is 0.0, since
rewards come from reward models.

Every step is a unary call rather than a message on the stream `Connect`: up to 0.3 ms slower (1.3 instead of 1.0 ms for
one small world), but with a deadline and with retries, which `step_id` makes safe.
"""

from typing import Any, Unpack

import gymnasium
import numpy as np
import numpy.typing as npt

from freerein.envs.env_session import ADDRESS, EnvSession, Observation, Pixels, SessionOptions, frames_of, truth_info
from freerein.errors import FailedPrecondition
from freerein.types.sim import StepResponse, Truth

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"]}


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

    metadata = METADATA

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
        """Begins an episode; `options` are ignored.

        `info` has the keys of a step's; in a privileged session `truth` is missing where the service had begun the
        episode already. `info["new_session"]` is there, and true, where the service had lost the session, as by a
        restart, and made another one; without a seed its episodes are drawn anew.
        """
        super().reset(seed=seed)
        begun, info = self._begun, reset_info(None, 0, is_new_session=False)
        if begun is None or seed is not None:
            reply = self._session.begin(seed=seed)
            begun = frames_of(reply.frames, 0)
            info = reset_info(reply.truth, 0, is_new_session=self._session.is_new)
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
        return observation, float(rewards_of(reply)[0]), terminated, truncated, step_info(reply, 0)

    def render(self) -> Pixels | None:
        """Returns the first camera's latest frame, uint8 (H, W, 3); None unless `render_mode` is `rgb_array`."""
        return self._session.rgb_frames(self._latest) if self.render_mode else None

    def close(self) -> None:
        """Closes the session; may be called twice."""
        self._session.close()


def rewards_of(reply: StepResponse) -> npt.NDArray[np.float64]:
    """Returns the rewards of a step, float64 (N,): zeros, or in a privileged session the oracle's."""
    return np.array(reply.reward if reply.truth is None else reply.truth.reward, np.float64)


def reset_info(truth: Truth | None, index: int, *, is_new_session: bool) -> dict[str, Any]:
    """Returns the `info` of a reset of one environment: the keys of a step's, and `new_session` where that is so."""
    new_session = {"new_session": True} if is_new_session else {}
    return {"diverged": False, **new_session, **truth_info(truth, index)}


def step_info(reply: StepResponse, index: int) -> dict[str, Any]:
    """Returns the `info` of a step of one environment."""
    return {"diverged": bool(reply.diverged[index]), **truth_info(reply.truth, index)}
