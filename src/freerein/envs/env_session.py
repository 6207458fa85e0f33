"""A blocking session of the sim service with camera observations and Gymnasium spaces."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, TypedDict

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from freerein.clients import Channel, SimClient, SyncClient
from freerein.envs.leased_session import LeasedSession
from freerein.errors import (
    FailedPrecondition,
    InvalidInput,
    Overloaded,
    SessionNotFound,
    StepOutOfOrder,
    WorkerLost,
    must_be,
)
from freerein.ports import PORTS
from freerein.types.common import ActionSpec, Camera
from freerein.types.sim import (
    CameraFrames,
    CreateSessionRequest,
    ResetRequest,
    ResetResponse,
    StepRequest,
    StepResponse,
    Task,
    Truth,
)
from freerein.unknown_names import described

Pixels = npt.NDArray[np.uint8]
Observation = Pixels | dict[str, Pixels]

ADDRESS = f"127.0.0.1:{PORTS['sim'].grpc}"
_LEASE_S = 60.0
_MEANINGS = {
    **dict.fromkeys(("max_episode_steps", "max_steps", "time_limit"), "episode_timesteps"),
    **dict.fromkeys(("frame_skip", "frameskip"), "action_repeat"),
    "camera_name": "cameras",
    "camera": "cameras",
    "render_size": "height",
}
"""Options of other packages' environments, and what they are here."""


class SessionOptions(TypedDict, total=False):
    """Keyword arguments of both environments.

    Attributes:
        cameras: Cameras to observe; empty for the task's first. One camera: Box; several: Dict.
        height: Frame height in pixels; 0 means the cameras' own.
        width: Frame width in pixels; 0 means the cameras' own.
        privileged: For evaluation only: oracle reward, and `info["truth"]` with `state` (float64 (S,)), `reward` and
            `success` of each step, and of resets that begin an episode.
        conditions: Conditions of the task, named variations; empty for the nominal task.
        episode_timesteps: Timesteps after which an episode is truncated; 0 for the task's own. (The `max_episode_steps`
            of `gymnasium.make` is not ours: it counts actions, and cannot lengthen an episode.)
        action_repeat: Timesteps that each action is held for, or until the episode ends; at most 64. Steps return what
            the last of them does.
        lease_s: Seconds after which the service ends the session when this process is gone or stopped; at most 3600.
            While it lives, a thread renews the lease.
        render_mode: None, or `rgb_array`: `render()` returns the first camera's latest frame, uint8 (H, W, 3).
        token: Bearer token; empty for none. `gymnasium.make` records it in `env.spec`, which wrappers may log or save;
            an environment that its class makes has no spec.
        root_certificates: PEM root certificates for TLS; None for no TLS.
    """

    cameras: Sequence[str]
    height: int
    width: int
    privileged: bool
    conditions: Sequence[str]
    episode_timesteps: int
    action_repeat: int
    lease_s: float
    render_mode: str | None
    token: str
    root_certificates: bytes | None


class EnvSession:
    """A session of the sim service, with a connection of its own.

    Attributes:
        task: The task.
        cameras: The cameras that are observed.
        observation_space: Of one environment: Box uint8 (H, W, C), or a Dict of Boxes for several cameras.
        action_space: Of one environment: Box float32 (A,) in [-1, 1], or Discrete.
        metadata: Gymnasium's `render_modes` and `render_fps`.
        is_new: Whether the latest `begin` took a new session, as the service had lost the old one.
    """

    def __init__(
        self,
        task: str,
        address: str,
        *,
        num_envs: int = 1,
        cameras: Sequence[str] = (),
        height: int = 0,
        width: int = 0,
        privileged: bool = False,
        conditions: Sequence[str] = (),
        episode_timesteps: int = 0,
        action_repeat: int = 1,
        lease_s: float = _LEASE_S,
        render_mode: str | None = None,
        token: str = "",
        root_certificates: bytes | None = None,
        **unknown: object,
    ) -> None:
        _check_options(render_mode, action_repeat, unknown)
        self._connect = partial(Channel, address, token=token, root_certificates=root_certificates)
        self._request = CreateSessionRequest(
            task,
            num_envs,
            lease_s=lease_s,
            height=height,
            width=width,
            privileged=privileged,
            conditions=tuple(conditions),
            max_episode_steps=episode_timesteps,
        )
        self._action_repeat = action_repeat
        self.is_new = False
        self._open()
        with ExitStack() as on_error:
            on_error.callback(self.close)
            self.task: Task = self._lease.created.task
            self.cameras = tuple(cameras) or (self.task.cameras[0].name,)
            self.observation_space = _observation_space(self.task, self.cameras, height, width)
            self.action_space = _action_space(self.task.action)
            step_s = action_repeat * self.task.control_dt_s
            self.metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 1.0 / step_s}
            on_error.pop_all()

    def _open(self) -> None:
        """Creates the session, over a connection of its own."""
        self._sim = SyncClient(SimClient(self._connect()))
        with ExitStack() as on_error:
            on_error.callback(self._sim.close)
            self._lease = LeasedSession(self._sim, self._request)
            on_error.pop_all()
        self._session = self._lease.created.session
        self._step_id = 0
        self._unknown = 0  # latest steps of which it is unknown whether they were made
        self._ahead = 0  # by how many steps the count may be too large since `reset`

    def begin(self, *, seed: int | None, envs: tuple[int, ...] = ()) -> ResetResponse:
        """Begins new episodes as `reset`; where the service lost the session, in all environments of another one."""
        self.is_new = False
        try:
            return self.reset(seed=seed, envs=envs)
        except (SessionNotFound, WorkerLost):
            self.close()
            self._open()
            self.is_new = True
            return self.reset(seed=seed)

    def reset(self, *, seed: int | None, envs: tuple[int, ...] = ()) -> ResetResponse:
        """Begins new episodes in `envs`, or in all environments if empty."""
        reply = self._sim.reset(ResetRequest(self._session, envs, seed, self.cameras))
        if not envs:
            self._ahead, self._unknown = self._ahead + self._unknown, 0
        return reply

    def step(self, actions: npt.ArrayLike) -> StepResponse:
        """Steps all environments.

        Args:
            actions: (N, A) in [-1, 1], or (N,) discrete choices.

        Raises:
            ServiceError: After Unavailable, DeadlineExceeded and Internal, and after an interrupt, it is unknown
                whether the step was made. It is counted as made; if it was not, steps are refused until `reset`.
        """
        encoded = self._encoded(actions)
        while True:
            try:
                reply = self._next_step(encoded)
            except StepOutOfOrder:
                if not self._ahead:
                    raise
                self._step_id, self._ahead = self._step_id - 1, self._ahead - 1
            else:
                self._ahead = self._unknown = 0
                return reply

    def observation(self, frames: Mapping[str, Pixels]) -> Observation:
        """Returns a copy of frames as an observation, or a batch of observations."""
        copies = {camera: np.array(frames[camera]) for camera in self.cameras}
        return copies if len(copies) > 1 else copies[self.cameras[0]]

    def rgb_frames(self, frames: Mapping[str, Pixels] | None) -> Pixels:
        """Returns the first camera's frames as RGB (..., H, W, 3).

        Raises:
            FailedPrecondition: There are none yet.
        """
        if frames is None:
            raise FailedPrecondition("`render` needs an episode; none was begun.", hint="Call reset() first.")
        pixels = frames[self.cameras[0]]
        return np.repeat(pixels, 3, axis=-1) if pixels.shape[-1] == 1 else np.array(pixels)

    def close(self) -> None:
        """Closes the session and the connection; may be called twice."""
        self._lease.close()

    def _next_step(self, actions: npt.NDArray[Any]) -> StepResponse:
        request = StepRequest(
            self._session, self._step_id + 1, actions, self.cameras, action_repeat=self._action_repeat
        )
        try:
            reply = self._sim.step(request)
        except (InvalidInput, FailedPrecondition, Overloaded):
            raise
        except BaseException:
            self._step_id, self._unknown = self._step_id + 1, self._unknown + 1
            raise
        self._step_id += 1
        return reply

    def _encoded(self, actions: npt.ArrayLike) -> npt.NDArray[Any]:
        if isinstance(self.action_space, spaces.Discrete):
            return np.asarray(actions, np.int64)[..., np.newaxis]
        return np.asarray(actions, np.float32)


def frames_of(frames: CameraFrames, index: int) -> dict[str, Pixels]:
    """Returns one environment's frames by camera, each uint8 (H, W, C)."""
    return {camera: pixels[index] for camera, pixels in frames.items()}


def truth_info(truth: Truth | None, index: int) -> dict[str, Any]:
    """Returns the `info` entry of one environment's ground truth; empty unless the session is privileged."""
    if truth is None:
        return {}
    state, reward, success = truth.state[index], truth.reward[index], truth.success[index]
    return {"truth": {"state": np.array(state), "reward": float(reward), "success": bool(success)}}


def _check_options(render_mode: str | None, action_repeat: int, unknown: Mapping[str, object]) -> None:
    for name in unknown:
        known = SessionOptions.__annotations__
        raise InvalidInput(
            f"Options of an environment are {', '.join(f'`{each}`' for each in known)}; "
            f"got {described(name, known, _MEANINGS)}",
            field="options",
            hint="help(freerein.envs.env_session.SessionOptions) describes them.",
        )
    if render_mode not in (None, "rgb_array"):
        raise must_be("render_mode", "None or rgb_array", "another one", hint="Ask for rgb_array.")
    if action_repeat < 1:
        raise must_be("action_repeat", "at least 1 timestep", action_repeat, hint="Leave it out for 1.")


def _observation_space(task: Task, cameras: tuple[str, ...], height: int, width: int) -> spaces.Space[Any]:
    by_name = {camera.name: camera for camera in task.cameras}
    if unknown := [name for name in cameras if name not in by_name]:
        rule, got = f"among {', '.join(by_name)}", f"{len(unknown)} that are not"
        raise must_be("cameras", rule, got, hint="Name cameras of the task, or none for its first.")
    boxes: dict[str, spaces.Space[Any]] = {name: _box(by_name[name], height, width) for name in cameras}
    return spaces.Dict(boxes) if len(boxes) > 1 else boxes[cameras[0]]


def _box(camera: Camera, height: int, width: int) -> spaces.Space[Any]:
    return spaces.Box(0, 255, (height or camera.height, width or camera.width, camera.channels), np.uint8)


def _action_space(action: ActionSpec) -> spaces.Space[Any]:
    return spaces.Discrete(action.choices) if action.choices else spaces.Box(-1.0, 1.0, (action.size,), np.float32)
