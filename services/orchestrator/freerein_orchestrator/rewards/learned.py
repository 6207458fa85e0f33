"""Reward `learned`: 1 where a reward model prefers the goal text to its rival captions, else 0."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from freerein.clients import SyncClient
from freerein.goal_text import not_known
from freerein.types.common import Camera, ModelRef
from freerein.types.reward import Mode, RewardRequest, RewardResponse
from freerein_orchestrator.rewards.entry import RewardEntry, RewardSetting
from freerein_orchestrator.rl.errors import IterationRejected
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.vec_env import CameraFrames, Rewards, moments

_RANGES: Mapping[Mode, str] = {"binary": "0 or 1", "raw": "a similarity, within [-1, 1]"}
_MAX_SIMILARITY = 1.001
"""Products in single precision may exceed 1 a little."""


@dataclass(frozen=True)
class LearnedReward(Reward):
    """The rewards of a model of the reward service.

    Attributes:
        service: The service's client.
        goal_text: The goal, as a text.
        model: Which model; with a version, so that it stays the same.
        mode: `binary`, 1 where the goal text beats its rival captions, else 0; or `raw`, the similarity.
    """

    service: SyncClient
    goal_text: str
    model: ModelRef = ModelRef()
    mode: Mode = "binary"

    def of_frames(self, frames: CameraFrames, _true_rewards: Rewards | None = None) -> Rewards:
        """Returns the rewards. A lone moment is sent twice: alone, the service would batch it with other requests.

        Raises:
            IterationRejected: A reward is not one of this mode.
        """
        count = moments(frames)
        sent = frames if count > 1 else {name: np.repeat(each, 2, axis=0) for name, each in frames.items()}
        rewards = self._request(sent).rewards
        valid = np.isin(rewards, (0, 1)) if self.mode == "binary" else np.abs(rewards) <= _MAX_SIMILARITY
        if not valid.all():
            raise IterationRejected(
                f"A reward in the mode {self.mode} must be {_RANGES[self.mode]}; got {rewards[~valid][0]}.",
                hint="See the log of the reward service.",
            )
        return rewards[:count]

    def resolve(self, cameras: Sequence[Camera]) -> RewardResponse:
        """Returns the model's answer to two blank frames of each camera: its version, and how it reads the goal text.

        Raises:
            InvalidInput: The model does not know a word of the goal text, takes no such text, or needs another camera.
            NotFound: There is no such model.
            FailedPrecondition: None is active.
        """
        answer = self._request(
            {each.name: np.zeros((2, each.height, each.width, each.channels), np.uint8) for each in cameras}
        )
        if answer.unknown:
            raise not_known(answer.unknown, answer.did_you_mean, field="config.goal_text")
        return answer

    def _request(self, frames: CameraFrames) -> RewardResponse:
        request = RewardRequest(self.goal_text, dict(frames), mode=self.mode, model=self.model)
        return self.service.reward(request)


def served_entry(mode: Mode, supervision: str, *, default_model: str = "", encodes_objects: bool = True) -> RewardEntry:
    """Returns the entry of a reward that the reward service computes.

    Args:
        mode: Of the rewards.
        supervision: For the cards of policies.
        default_model: The model of a setting that names none; empty for the service's default.
        encodes_objects: As of `RewardEntry`.
    """

    def reward(setting: RewardSetting) -> LearnedReward:
        model = ModelRef(setting.model.name or default_model, setting.model.version)
        return LearnedReward(setting.service, setting.goal_text, model, mode)

    return RewardEntry(
        lambda setting, _: reward(setting),
        supervision,
        frozenset({"frames"}),
        own_cameras=True,
        resolve_model=lambda setting: reward(setting).resolve(setting.cameras).model,
        encodes_objects=encodes_objects,
    )


LEARNED = served_entry("binary", "goal text; the reward model saw images, noun phrases and captions made from pixels")
