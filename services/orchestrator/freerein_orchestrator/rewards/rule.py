"""Reward `rule`: 1 where the rules of table 4.1 give a frame the goal as a caption, by the grounding model's places.

No second model learns from these captions: what that is worth is the difference to the reward `learned`.
"""

from dataclasses import dataclass

import numpy as np

from freerein import images
from freerein.clients import SyncClient
from freerein.criteria import CRITERIA
from freerein.criterion_text import stated_criterion
from freerein.errors import InvalidInput
from freerein.goal_text import Grammar, not_known, noun_phrases
from freerein.relations import SpatialRelation, caption
from freerein.types.common import Image, ModelRef
from freerein.types.reward import DescribeRequest, DescribeResponse
from freerein_orchestrator.rewards.entry import RewardEntry, RewardSetting
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.vec_env import CameraFrames, Frames, Rewards

_CLOSE_TO = CRITERIA["close_to"]
_IMAGES_AT_ONCE = 128


@dataclass(frozen=True)
class Rule:
    """When a goal holds.

    Attributes:
        phrases: The noun phrases of its two things.
        captions: Of these, the captions with which it holds.
    """

    phrases: tuple[str, str]
    captions: frozenset[str]

    @classmethod
    def of(cls, goal_text: str) -> "Rule":
        """Returns the rule of a goal: one of the five relations, or `close to`, which is each of them but one.

        Raises:
            InvalidInput: The text relates no two things in this way.
        """
        if len(found := noun_phrases([goal_text])) == len(("first", "second")):
            first, second = found
            said = Grammar(found, [goal_text]).read(goal_text).statement
            if said is not None:
                return cls((first, second), frozenset((said.caption,)))
        criterion, nouns = stated_criterion(goal_text) or (None, ())
        if criterion is not _CLOSE_TO:
            raise InvalidInput(
                "The reward `rule` needs a goal text that relates two things; got another.",
                field="config.goal_text",
                hint="For example: a yellow block to the left of a green block.",
            )
        first, second = nouns
        near = [each for each in SpatialRelation if each is not SpatialRelation.APART_FROM]
        return cls((first, second), frozenset(caption(first, each, second) for each in near))


@dataclass(frozen=True)
class RuleReward(Reward):
    """Asks the reward service to describe frames of the first camera.

    Attributes:
        service: The service's client.
        rule: When the goal holds.
        model: The grounding model.
    """

    service: SyncClient
    rule: Rule
    model: ModelRef

    def of_frames(self, frames: CameraFrames, _true_rewards: Rewards | None = None) -> Rewards:
        """Returns the rewards."""
        camera, seen = next(iter(frames.items()))
        encoded = tuple(_encode(frame, camera) for frame in seen)
        parts = [encoded[start : start + _IMAGES_AT_ONCE] for start in range(0, len(encoded), _IMAGES_AT_ONCE)]
        described = [each for part in parts for each in self._describe(part).descriptions]
        return np.array([not self.rule.captions.isdisjoint(each.captions) for each in described], np.float32)

    def resolve(self, blank: Frames, camera: str) -> ModelRef:
        """Returns the version of the model that answers, for a frame, uint8 (H, W, C), of a camera.

        Raises:
            InvalidInput: The model does not know a word of the goal text.
        """
        answer = self._describe((_encode(blank, camera),))
        if answer.unknown:
            raise not_known(answer.unknown, "", field="config.goal_text")
        return answer.model

    def _describe(self, encoded: tuple[Image, ...]) -> DescribeResponse:
        response: DescribeResponse = self.service.describe(
            DescribeRequest(encoded, self.rule.phrases, model=self.model)
        )
        return response


def _encode(frame: Frames, camera: str) -> Image:
    return images.encode(frame, encoding="raw_rgb8" if frame.shape[2] == 3 else "raw_gray8", camera=camera)


def _make(setting: RewardSetting) -> RuleReward:
    return RuleReward(setting.service, Rule.of(setting.goal_text), setting.model)


def _resolve(setting: RewardSetting) -> ModelRef:
    camera = setting.cameras[0]
    return _make(setting).resolve(np.zeros((camera.height, camera.width, camera.channels), np.uint8), camera.name)


RULE = RewardEntry(
    lambda setting, _: _make(setting),
    "goal text; the grounding model saw captions of single objects",
    frozenset({"frames"}),
    own_cameras=True,
    resolve_model=_resolve,
    encodes_objects=False,
)
