import json
from pathlib import Path

import numpy as np
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein.learning.actor_critic.policy_files import load_policy, save_policy
from freerein_orchestrator.rl.initial_network import init_network
from freerein_orchestrator.rl.network_policy import NetworkPolicy

FRAMES = np.random.default_rng(0).integers(256, size=(3, 2, 12, 12, 1), dtype=np.uint8)
START, CONTINUE = np.ones(2, np.bool_), np.zeros(2, np.bool_)


def make(*, recurrent: bool = False) -> ActorCritic:
    spec = ActorCriticSpec(height=12, width=12, channels=1, feature_size=8, hidden_size=8, recurrent=recurrent)
    network = init_network(spec, torch.Generator().manual_seed(0))
    network.calibrate(torch.from_numpy(FRAMES).flatten(end_dim=1))
    return network


def test_a_saved_policy_acts_the_same_when_loaded(tmp_path: Path) -> None:
    network = make()
    save_policy(network, tmp_path, card={"task": "grid"})
    policy = load_policy(tmp_path, device="cpu")
    assert (policy.card["task"], policy.card["kind"]) == ("grid", "ppo")
    assert policy.card["sha256"] == weights.sha256(network)
    expected = NetworkPolicy(network).act(FRAMES[0], START)
    np.testing.assert_array_equal(NetworkPolicy(policy.network).act(FRAMES[0], START), expected)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["policy.json", "policy.safetensors"]


@pytest.mark.parametrize("change", [{"sha256": "0" * 64}, {"kind": "distilled"}])
def test_a_card_of_another_policy_is_refused(tmp_path: Path, change: dict[str, str]) -> None:
    save_policy(make(), tmp_path, card={})
    card = json.loads((tmp_path / "policy.json").read_bytes())
    (tmp_path / "policy.json").write_text(json.dumps(card | change))
    with pytest.raises(InvalidInput, match="card"):
        load_policy(tmp_path, device="cpu")


def test_sampled_actions_come_from_the_generator_and_the_mode_from_none() -> None:
    network, draws = make(), [torch.Generator().manual_seed(seed) for seed in (1, 1, 2)]
    mode = NetworkPolicy(network).act(FRAMES[0], START)
    first, again, other = (NetworkPolicy(network, generator=draw).act(FRAMES[0], START) for draw in draws)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert not np.array_equal(first, mode)
    assert np.abs(first).max() <= 1.0


def test_the_recurrent_state_is_kept_until_an_episode_starts() -> None:
    network = make(recurrent=True)
    policy, fresh = NetworkPolicy(network), NetworkPolicy(network)
    policy.act(FRAMES[0], START)
    continued = policy.act(FRAMES[1], CONTINUE)
    assert not np.array_equal(continued, fresh.act(FRAMES[1], START))
    np.testing.assert_array_equal(policy.act(FRAMES[1], START), NetworkPolicy(network).act(FRAMES[1], START))


def test_an_action_is_held_as_often_as_it_is_repeated_or_until_an_episode_starts() -> None:
    spec = ActorCriticSpec(height=12, width=12, channels=1, feature_size=8, hidden_size=8, action_repeat=2)
    network = init_network(spec, torch.Generator().manual_seed(0))
    network.calibrate(torch.from_numpy(FRAMES).flatten(end_dim=1))
    policy = NetworkPolicy(network)
    new = [NetworkPolicy(network).act(frames, START) for frames in FRAMES]

    starts = (START, CONTINUE, CONTINUE)
    first, held, second = (policy.act(*each) for each in zip(FRAMES, starts, strict=True))

    np.testing.assert_array_equal([first, held, second], [new[0], new[0], new[2]])
    one_starts = policy.act(FRAMES[1], np.array([True, False]))
    np.testing.assert_allclose(one_starts, [new[1][0], new[2][1]], rtol=1e-5)
