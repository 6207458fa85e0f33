"""Rewards from language: the reward service's answers to an environment's frames and a goal text."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, TypedDict, Unpack

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper

from freerein.clients import Channel, RewardClient, SyncClient
from freerein.envs.autoreset import check_same_step, last_observations
from freerein.envs.env_session import Observation
from freerein.errors import InvalidInput
from freerein.goal_text import not_known
from freerein.ports import PORTS
from freerein.types.common import ModelRef
from freerein.types.reward import Mode, RewardRequest, RewardResponse

ADDRESS = f"127.0.0.1:{PORTS['reward'].grpc}"


class RewardOptions(TypedDict, total=False):
    """Keyword arguments of both wrappers.

    Attributes:
        address: `host:port` of the reward service; by default its port on this machine.
        camera: What the model calls the camera of an observation that is one frame; by default its name in freerein's
            environments, and elsewhere the model's only camera.
        model: Name of the model; empty for the default one. The version that is active now is used until the end.
        mode: `binary`, 1 where the goal text fits the frame better than all rivals, else 0; or `raw`, the similarity.
        rivals: Texts that the goal text must beat; by default the goal text with every other relation, and that one of
            its objects is missing.
        token: Bearer token; empty for none. It is not recorded in `env.spec`.
        root_certificates: PEM root certificates for TLS; None for no TLS.
    """

    address: str
    camera: str
    model: str
    mode: Mode
    rivals: Sequence[str]
    token: str
    root_certificates: bytes | None


class TextReward(gymnasium.Wrapper[Observation, Any, Observation, Any], RecordConstructorArgs):
    """Rewards each step by the frame after it: does it show what a goal text says?

    `info["similarity"]` is that of frame and goal text; `info["in_distribution"]` says how familiar the frame is to the
    model: below 0.03, do not trust the reward.

    Args:
        env: Observes frames, uint8 (H, W, C), or a dict of them by camera. Put what changes frames around this wrapper.
        goal_text: What the frames should show.
        options: See `RewardOptions`.

    Raises:
        InvalidInput: The model does not know a word of the goal text, or the observations are no frames.
        ServiceError: As `step`: the service refused, was unreachable or did not answer in time.
    """

    def __init__(self, env: gymnasium.Env[Observation, Any], goal_text: str, **options: Unpack[RewardOptions]) -> None:
        recorded: dict[str, Any] = {**options}
        recorded.pop("token", None)  # specs are logged and saved
        RecordConstructorArgs.__init__(self, goal_text=goal_text, **recorded)
        super().__init__(env)
        self._rewards = _FrameRewards(env, env.observation_space, goal_text, **options)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode; `info` has the keys of a step's, NaN: no reward is asked of its first frame."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, {**info, **dict.fromkeys(self._rewards.judgements, np.nan)}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Takes one action; the reward is that of the frame after it."""
        observation, _, terminated, truncated, info = self.env.step(action)
        answer = self._rewards.of(_batch_of_one(observation))
        for name, values in _judgements(answer).items():
            info[name] = float(values[0])
        return observation, float(answer.rewards[0]), terminated, truncated, info

    def close(self) -> None:
        """Closes the environment, and the connection to the reward service."""
        self._rewards.close()
        super().close()


class VectorTextReward(VectorWrapper[Observation, Any, Observation, Any, npt.NDArray[Any]]):
    """`TextReward` of a vector of N environments, with one call for all of them.

    Where an episode ended, the last frame of the old one is rewarded: `info["final_info"]` has its `similarity` and
    `in_distribution`, and `info` has NaN there, as after a reset.

    Args:
        env: Resets in the step that ends an episode (`AutoresetMode.SAME_STEP`).
        goal_text: What the frames should show.
        options: See `RewardOptions`.

    Raises:
        InvalidInput: As `TextReward`, or the environments reset in another step.
        ServiceError: As `step`: the service refused, was unreachable or did not answer in time.
    """

    def __init__(
        self, env: VectorEnv[Observation, Any, npt.NDArray[Any]], goal_text: str, **options: Unpack[RewardOptions]
    ) -> None:
        super().__init__(env)
        check_same_step(env)
        self._rewards = _FrameRewards(env, env.single_observation_space, goal_text, **options)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins episodes; `info` has the keys of a step's, NaN: no reward is asked of first frames."""
        observations, info = self.env.reset(seed=seed, options=options)
        for name in self._rewards.judgements:
            info |= _entry(name, np.full(self.num_envs, np.nan, np.float32), np.ones(self.num_envs, np.bool_))
        return observations, info

    def step(
        self, actions: Any
    ) -> tuple[Observation, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Takes one action in each environment; rewards are float64 (N,)."""
        observations, _, terminated, truncated, info = self.env.step(actions)
        ended = terminated | truncated
        answer = self._rewards.of(last_observations(observations, ended, info))
        for name, values in _judgements(answer).items():
            info |= _entry(name, np.where(ended, np.nan, values), np.ones(self.num_envs, np.bool_))
            if ended.any():
                info["final_info"] |= _entry(name, np.where(ended, values, np.nan), ended.copy())
        return observations, answer.rewards.astype(np.float64), terminated, truncated, info

    def close(self, **kwargs: Any) -> None:
        """Closes the environments, and the connection to the reward service."""
        self._rewards.close()
        super().close(**kwargs)


class _FrameRewards:
    """The reward service's answers to observations; see `RewardOptions`.

    Attributes:
        judgements: Entries that each answer adds to `info`, by name.
    """

    def __init__(
        self,
        env: Any,
        space: spaces.Space[Any],
        goal_text: str,
        *,
        address: str = ADDRESS,
        camera: str = "",
        model: str = "",
        mode: Mode = "binary",
        rivals: Sequence[str] = (),
        token: str = "",
        root_certificates: bytes | None = None,
    ) -> None:
        only_camera = camera or next(iter(getattr(env.unwrapped, "cameras", ())), "")
        shapes = _frame_shapes(space, only_camera)
        self._cameras = tuple(shapes)
        self._request = RewardRequest(goal_text, rivals=tuple(rivals), mode=mode, model=ModelRef(model))
        self._client = SyncClient(RewardClient(Channel(address, token=token, root_certificates=root_certificates)))
        with ExitStack() as on_error:
            on_error.callback(self.close)
            answer = self._ask({name: np.zeros((1, *shape), np.uint8) for name, shape in shapes.items()})
            _check_known(answer)
            self._request = replace(self._request, model=answer.model)
            self.judgements = tuple(_judgements(answer))
            on_error.pop_all()

    def of(self, observations: Observation) -> RewardResponse:
        """Returns the answer to the observations of N environments."""
        if not isinstance(observations, dict):
            return self._ask({self._cameras[0]: observations})
        return self._ask({camera: observations[camera] for camera in self._cameras})

    def close(self) -> None:
        self._client.close()

    def _ask(self, frames: dict[str, npt.NDArray[np.uint8]]) -> RewardResponse:
        return self._client.reward(replace(self._request, frames=frames))


def _frame_shapes(space: spaces.Space[Any], only_camera: str) -> dict[str, tuple[int, ...]]:
    """Returns the shape of each camera's frames."""
    parts = space.spaces if isinstance(space, spaces.Dict) else {only_camera: space}
    shapes: dict[str, tuple[int, ...]] = {
        name: part.shape
        for name, part in parts.items()
        if isinstance(part, spaces.Box) and part.dtype == np.uint8 and len(part.shape) == 3
    }
    if not shapes:
        raise InvalidInput(
            f"The environment must observe frames, uint8 (H, W, C), or a dict of them; it observes {space}.",
            field="env",
            hint="Put wrappers that change frames around the one that rewards them.",
        )
    return shapes


def _check_known(answer: RewardResponse) -> None:
    if answer.unknown:
        raise not_known(answer.unknown, answer.did_you_mean, field="goal_text")


def _batch_of_one(observation: Observation) -> Observation:
    if isinstance(observation, dict):
        return {name: values[np.newaxis] for name, values in observation.items()}
    return observation[np.newaxis]


def _entry(name: str, values: npt.NDArray[np.float32], has: npt.NDArray[np.bool_]) -> dict[str, npt.NDArray[Any]]:
    """Returns an entry of a vector's `info`: values (N,), and which environments have one."""
    return {name: values, f"_{name}": has}


def _judgements(answer: RewardResponse) -> dict[str, npt.NDArray[np.float32]]:
    """Returns the entries of `info`, float32 (N,) each."""
    judgements = {"similarity": answer.similarities, "in_distribution": answer.in_distribution}
    return {name: values for name, values in judgements.items() if len(values)}  # a grounding model says only the first
