"""Where rewards come from: what is seen, or, to compare with, what is true."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias, cast

import numpy as np
import numpy.typing as npt

from freerein.clients import SyncClient
from freerein.errors import FailedPrecondition
from freerein.types.common import ModelRef
from freerein.types.reward import Mode, RewardRequest, RewardResponse
from freerein_orchestrator.rejection import Rejected
from freerein_orchestrator.rollout import Rewards

_POSSIBLE: Mapping[Mode, str] = {"binary": "0 or 1", "raw": "a cosine, within [-1, 1]"}
_LARGEST_COSINE = 1.001
"""Vectors of length 1 in single precision may have a product a little above 1."""

Frames: TypeAlias = npt.NDArray[np.uint8]
Judge: TypeAlias = Callable[[Frames, Rewards | None], Rewards]
"""Given what was seen of M steps of single environments, uint8 (M, H, W, C), returns the rewards, float32 (M,).

Beside it come the task's own rewards, float32 (M,), in a privileged session; in any other, None.
"""


@dataclass(frozen=True)
class LearnedReward:
    """The reward service's: what a model sees of a goal text in frames.

    Attributes:
        reward: The service, `SyncClient`.
        goal_text: What is to be seen.
        camera: Whose frames the environments show.
        model: Which model judges; with a version, so that it stays the same.
        mode: `binary`, 1 where the goal text beats its rivals, else 0; or `raw`, the similarity.
    """

    reward: SyncClient
    goal_text: str
    camera: str
    model: ModelRef = ModelRef()
    mode: Mode = "binary"

    def __call__(self, reached: Frames, _oracle: Rewards | None) -> Rewards:
        """Returns the rewards. A lone frame is sent twice: the service would judge it together with others' frames.

        Raises:
            Rejected: The service answered what is no reward of this mode.
        """
        frames = np.repeat(reached, 2, axis=0) if len(reached) == 1 else reached
        rewards = self._ask(frames).rewards
        possible = np.isin(rewards, (0, 1)) if self.mode == "binary" else np.abs(rewards) <= _LARGEST_COSINE
        if not possible.all():
            raise Rejected(
                f"A reward in the mode {self.mode} must be {_POSSIBLE[self.mode]}; got {rewards[~possible][0]}.",
                hint="Look at the log of the reward service.",
            )
        return rewards[: len(reached)]

    def pin(self, height: int, width: int, channels: int) -> ModelRef:
        """Returns the model, with its version, that judges frames of a size, once it has judged some.

        Raises:
            InvalidInput: The service judges no such goal text, or no frames of this camera.
            NotFound: There is no such model.
            FailedPrecondition: None is active.
        """
        return self._ask(np.zeros((2, height, width, channels), np.uint8)).model

    def _ask(self, frames: Frames) -> RewardResponse:
        request = RewardRequest(self.goal_text, {self.camera: frames}, mode=self.mode, model=self.model)
        return cast(RewardResponse, self.reward.reward(request))


def oracle(_reached: Frames, oracle: Rewards | None) -> Rewards:
    """Returns the task's own rewards, which no learner without privileges has: to compare with.

    Raises:
        FailedPrecondition: The session is not privileged.
    """
    if oracle is None:
        raise FailedPrecondition(
            "The oracle's reward needs a privileged session; this one is not.", hint="Ask for a learned reward."
        )
    return oracle
