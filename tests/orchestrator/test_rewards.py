"""Rewards as entries of a registry: what each may see, and what it needs."""

from dataclasses import replace

import pytest

from freerein.config import parse
from freerein.errors import InvalidInput
from freerein_orchestrator.kinds.ppo import session_request
from freerein_orchestrator.kinds.ppo_config import PPORunConfig
from freerein_orchestrator.rewards import REWARDS


@pytest.mark.parametrize("name", REWARDS)
def test_only_rewards_that_declare_themselves_privileged_get_privileged_state(name: str) -> None:
    entry = REWARDS[name]
    given = {
        "encoder": "spatial" if entry.needs_eye is False else "goal_eye",
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
