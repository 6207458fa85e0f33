import json
from pathlib import Path

import numpy as np
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein_orchestrator import policy_artifact
from freerein_orchestrator.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.policy_artifact import PolicyActor

FRAMES = np.random.default_rng(0).integers(256, size=(3, 2, 12, 12, 1), dtype=np.uint8)
START, GO_ON = np.ones(2, np.bool_), np.zeros(2, np.bool_)


def make(*, is_recurrent: bool = False) -> ActorCritic:
    spec = ActorCriticSpec(height=12, width=12, channels=1, features=8, hidden=8, is_recurrent=is_recurrent)
    network = ActorCritic(spec)
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    network.calibrate(torch.from_numpy(FRAMES).flatten(end_dim=1))
    return network


def test_a_policy_that_is_saved_and_loaded_acts_alike(tmp_path: Path) -> None:
    network = make()
    policy_artifact.save(network, tmp_path, card={"task": "grid"})
    policy = policy_artifact.load(tmp_path, device="cpu")
    assert (policy.card["task"], policy.card["kind"]) == ("grid", "ppo")
    assert policy.card["sha256"] == weights.sha256(network)
    expected = PolicyActor(network).act(FRAMES[0], START)
    np.testing.assert_array_equal(PolicyActor(policy.network).act(FRAMES[0], START), expected)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["policy.json", "policy.safetensors"]


@pytest.mark.parametrize("change", [{"sha256": "0" * 64}, {"kind": "distilled"}])
def test_a_card_of_another_policy_is_refused(tmp_path: Path, change: dict[str, str]) -> None:
    policy_artifact.save(make(), tmp_path, card={})
    told = json.loads((tmp_path / "policy.json").read_bytes())
    (tmp_path / "policy.json").write_text(json.dumps(told | change))
    with pytest.raises(InvalidInput, match="card"):
        policy_artifact.load(tmp_path, device="cpu")


def test_what_is_drawn_comes_from_the_generator_and_the_likeliest_action_from_none() -> None:
    network, draws = make(), [torch.Generator().manual_seed(seed) for seed in (1, 1, 2)]
    likeliest = PolicyActor(network).act(FRAMES[0], START)
    first, again, other = (PolicyActor(network, generator=draw).act(FRAMES[0], START) for draw in draws)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert not np.array_equal(first, likeliest)
    assert np.abs(first).max() <= 1.0


def test_an_actor_remembers_until_an_episode_begins() -> None:
    network = make(is_recurrent=True)
    actor, fresh = PolicyActor(network), PolicyActor(network)
    actor.act(FRAMES[0], START)
    remembering = actor.act(FRAMES[1], GO_ON)
    assert not np.array_equal(remembering, fresh.act(FRAMES[1], START))
    np.testing.assert_array_equal(actor.act(FRAMES[1], START), PolicyActor(network).act(FRAMES[1], START))
