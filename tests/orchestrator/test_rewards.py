"""Rewards as entries of a registry: what each may see, and what it needs."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freerein.clients import Channel, RewardClient, SyncClient
from freerein.config import parse
from freerein.errors import InvalidInput
from freerein.types.common import Camera, ModelRef
from freerein_orchestrator.kinds.ppo import session_request
from freerein_orchestrator.kinds.ppo_config import PPORunConfig
from freerein_orchestrator.rewards import REWARDS
from freerein_orchestrator.rewards.entry import RewardSetting
from freerein_orchestrator.rewards.rule import Rule
from freerein_orchestrator.rl.config import PPOConfig


@pytest.mark.parametrize("name", REWARDS)
def test_only_rewards_that_declare_themselves_privileged_get_privileged_state(name: str) -> None:
    entry = REWARDS[name]
    given = {
        "encoder": "spatial" if entry.needs_object_encoder is False else "goal_eye",
        "dataset": "won" if "success_examples" in entry.sees else "",
    }
    config = parse(PPORunConfig, {"task": "grid", "reward": name, **given})
    assert session_request(config).privileged == (entry.privileged and "true_rewards" in entry.sees)
    assert entry.privileged or not entry.sees & {"true_rewards", "success_examples"}
    assert not replace(entry, privileged=False).gets_true_rewards


@pytest.mark.parametrize(
    ("config", "field"),
    [
        ({"reward": "learnt"}, "config.reward"),
        ({"reward": "curiosity"}, "config.encoder"),
        ({"reward": "shaping", "encoder": "spatial"}, "config.encoder"),
        ({"dataset": "won"}, "config.dataset"),
        ({"frame_stack": 0}, "config.frame_stack"),
        ({"frame_stack": 3}, "config.encoder"),
        ({"cameras": ["front", "left"]}, "config.encoder"),
        ({"cameras": ["front", "front"]}, "config.cameras"),
        ({"camera": "front", "cameras": ["left"]}, "config.cameras"),
        ({"reward": "curiosity", "encoder": "spatial", "reward_cameras": ["left"]}, "config.reward_cameras"),
    ],
)
def test_what_a_reward_does_not_take_is_refused(config: dict[str, object], field: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        parse(PPORunConfig, {"task": "grid", **config})
    assert refused.value.field == field


def test_the_rule_of_a_goal_is_its_caption_and_close_to_is_each_relation_but_apart_from() -> None:
    left = "the red block to the left of the green block"
    assert Rule.of(f"put {left}") == Rule(("the red block", "the green block"), frozenset((left,)))
    close = Rule.of("a blue object close to a yellow object")
    assert close.phrases == ("a blue object", "a yellow object")
    assert "a blue object below a yellow object" in close.captions
    assert "a blue object apart from a yellow object" not in close.captions
    with pytest.raises(InvalidInput, match="relates two things"):
        Rule.of("win")


@pytest.mark.e2e
def test_a_rule_rewards_frames_in_which_the_grounding_model_finds_things_as_the_goal_has_them(
    start_service: Callable[..., Any],
) -> None:
    frames = np.full((3, 64, 64, 3), (120, 135, 147), np.uint8)
    for frame, (red, green) in zip(frames, ((22, 34), (32, 24), (10, 50)), strict=True):
        frame[40:47, red - 3 : red + 4] = (219, 23, 18)
        frame[40:47, green - 3 : green + 4] = (31, 168, 41)
    network: Any = None  # no reward of these is of the policy
    earned = {}
    with SyncClient(RewardClient(Channel(start_service("freerein_reward").address))) as service:
        camera = Camera("front", 64, 64, 3)
        for goal in ("a red block to the left of a green block", "a red block close to a green block"):
            setting = RewardSetting(PPOConfig(), goal, "", (camera,), ModelRef(), service, Path())
            model = REWARDS["rule"].resolve_model(setting)
            assert model.name == "grounding"
            reward = REWARDS["rule"].make(replace(setting, model=model), network)
            earned[goal] = reward.of_frames({"front": frames}, None).tolist()
        assert list(earned.values()) == [[1, 0, 0], [1, 1, 0]]
        with pytest.raises(InvalidInput, match="crimson"):
            REWARDS["rule"].resolve_model(replace(setting, goal_text="a crimson block below a green block"))
    assert REWARDS["alive"].make(setting, network).of_frames({"front": frames}, None).tolist() == [1, 1, 1]
