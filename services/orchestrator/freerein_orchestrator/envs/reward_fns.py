"""Reward functions of frames: a served reward model, the oracle, or zero."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias, cast

import numpy as np
import numpy.typing as npt

from freerein.clients import SyncClient
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.types.common import ModelRef
from freerein.types.reward import Mode, RewardRequest, RewardResponse
from freerein_orchestrator.rl.errors import IterationRejected
from freerein_orchestrator.rl.vec_env import Rewards

_RANGES: Mapping[Mode, str] = {"binary": "0 or 1", "raw": "a similarity, within [-1, 1]"}
_MAX_SIMILARITY = 1.001
"""Products in single precision may exceed 1 a little."""

Frames: TypeAlias = npt.NDArray[np.uint8]
RewardFn: TypeAlias = Callable[[Frames, Rewards | None], Rewards]
"""Given M frames, uint8 (M, H, W, C), and their oracle rewards, float32 (M,), or None in an unprivileged session,
returns rewards, float32 (M,)."""


@dataclass(frozen=True)
class LearnedReward:
    """The rewards of a model of the reward service; a `RewardFn`.

    Attributes:
        reward: The service's client.
        goal_text: What the frames should show.
        camera: The frames' camera.
        model: Which model; with a version, so that it stays the same.
        mode: `binary`, 1 where the goal text beats its rival captions, else 0; or `raw`, the similarity.
    """

    reward: SyncClient
    goal_text: str
    camera: str
    model: ModelRef = ModelRef()
    mode: Mode = "binary"

    def __call__(self, frames: Frames, _oracle: Rewards | None) -> Rewards:
        """Returns the rewards. A lone frame is sent twice: alone, the service would batch it with other requests.

        Raises:
            IterationRejected: A reward is not one of this mode.
        """
        sent = np.repeat(frames, 2, axis=0) if len(frames) == 1 else frames
        rewards = self._request(sent).rewards
        valid = np.isin(rewards, (0, 1)) if self.mode == "binary" else np.abs(rewards) <= _MAX_SIMILARITY
        if not valid.all():
            raise IterationRejected(
                f"A reward in the mode {self.mode} must be {_RANGES[self.mode]}; got {rewards[~valid][0]}.",
                hint="See the log of the reward service.",
            )
        return rewards[: len(frames)]

    def resolve_model(self, height: int, width: int, channels: int) -> ModelRef:
        """Returns name and version of the model; as `resolve`."""
        return self.resolve(height, width, channels).model

    def resolve(self, height: int, width: int, channels: int) -> RewardResponse:
        """Returns the model's answer to two blank frames of a size: which one it is, and how it reads the goal text.

        Raises:
            InvalidInput: The model does not know a word of the goal text, takes no such text, or no frames of this
                camera.
            NotFound: There is no such model.
            FailedPrecondition: None is active.
        """
        answer = self._request(np.zeros((2, height, width, channels), np.uint8))
        if answer.unknown:
            raise InvalidInput(
                f"The model must know every word of the goal text; it does not know {', '.join(answer.unknown)}.",
                field="config.goal_text",
                hint="Relate two noun phrases of the model, such as: the red block is on the blue one.",
            )
        return answer

    def _request(self, frames: Frames) -> RewardResponse:
        request = RewardRequest(self.goal_text, {self.camera: frames}, mode=self.mode, model=self.model)
        return cast(RewardResponse, self.reward.reward(request))


def oracle_reward(_frames: Frames, oracle: Rewards | None) -> Rewards:
    """Returns the task's true rewards, to compare with; a `RewardFn`.

    Raises:
        FailedPrecondition: The session is not privileged.
    """
    if oracle is None:
        raise FailedPrecondition(
            "The oracle's reward needs a privileged session; this one is not.", hint="Ask for a learned reward."
        )
    return oracle


def zero_reward(frames: Frames, _oracle: Rewards | None) -> Rewards:
    """Returns zeros; a `RewardFn`."""
    return np.zeros(len(frames), np.float32)
