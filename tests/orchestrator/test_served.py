"""Environments over the network, with the real sim and reward services."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch

from freerein.clients import Channel, RewardClient, SimClient, Synchronous
from freerein.errors import FailedPrecondition
from freerein.learning import weights
from freerein.types.reward import RewardRequest
from freerein.types.sim import CreateSessionRequest
from freerein_orchestrator import ppo_training
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.served import Judge, LearnedReward, ServedEnvironments, oracle

pytestmark = pytest.mark.e2e
CPU = torch.device("cpu")
TASK, CAMERA, GOAL = "blocks.red-on-top-of-yellow", "front", "a red block on top of a yellow block"
FAST = PPOConfig(iterations=3, num_envs=2, steps=8, epochs=1, batch_size=8, hidden=8, features=8)
FRAME = (64, 64, 3)


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any]) -> Iterator[Synchronous]:
    with Synchronous(SimClient(Channel(start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1").address))) as sim:
        yield sim


@pytest.fixture(scope="module")
def reward(start_module_service: Callable[..., Any]) -> Iterator[Synchronous]:
    with Synchronous(RewardClient(Channel(start_module_service("freerein_reward").address))) as reward:
        yield reward


def served(sim: Synchronous, judge: Judge, *, privileged: bool = False, snapshot: bytes = b"") -> ServedEnvironments:
    request = CreateSessionRequest(TASK, num_envs=2, seed=3, privileged=privileged)
    return ServedEnvironments(sim, request, camera=CAMERA, judge=judge, snapshot=snapshot)


def test_what_was_reached_is_judged_also_where_an_episode_ended(sim: Synchronous, reward: Synchronous) -> None:
    environments = served(sim, LearnedReward(reward, GOAL, CAMERA))
    environments.reset()
    rng, ended = np.random.default_rng(0), False
    while not ended:
        step = environments.step(rng.uniform(-1, 1, (2, 3)).astype(np.float32))
        ended = bool((step.terminated | step.truncated).any())
    expected = reward.reward(RewardRequest(GOAL, {CAMERA: step.final_observations}))
    np.testing.assert_array_equal(step.rewards, expected.rewards)
    over = step.terminated | step.truncated
    assert not np.array_equal(step.final_observations[over], step.observations[over])
    environments.close()


def test_the_oracle_needs_a_privileged_session(sim: Synchronous) -> None:
    still = np.zeros((2, 3), np.float32)
    privileged, plain = served(sim, oracle, privileged=True), served(sim, oracle)
    for environments in (privileged, plain):
        environments.reset()
    assert privileged.step(still).rewards.shape == (2,)
    with pytest.raises(FailedPrecondition, match="privileged"):
        plain.step(still)
    for environments in (privileged, plain):
        environments.close()


def test_a_training_goes_on_in_another_session_to_the_same_bits(sim: Synchronous, reward: Synchronous) -> None:
    judge = LearnedReward(reward, GOAL, CAMERA)
    spec = ppo_training.design(FAST, observation=FRAME, action_size=3)
    environments = served(sim, judge)
    training = ppo_training.begin(FAST, spec, environments, device=CPU)
    training, _ = ppo_training.iterate(training, environments)
    saved = ppo_training.snapshot(training, environments=environments.snapshot())
    whole, _ = ppo_training.iterate(training, environments)
    digest = weights.sha256(whole.network)
    environments.close()

    restored, where = ppo_training.restore(saved, FAST, spec, device=CPU)
    others = served(sim, judge, snapshot=where)
    again, _ = ppo_training.iterate(restored, others)

    assert weights.sha256(again.network) == digest
    others.close()
