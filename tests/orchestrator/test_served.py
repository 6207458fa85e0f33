"""Environments over the network, with the real sim and reward services."""

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest
import torch

from freerein.clients import Channel, RewardClient, SimClient, SyncClient
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.learning import weights
from freerein.types.common import ModelRef
from freerein.types.reward import Mode, RewardRequest
from freerein.types.sim import CreateSessionRequest, StepResponse
from freerein_orchestrator import ppo_training
from freerein_orchestrator.judges import Frames, Judge, LearnedReward, oracle
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.ppo_loop import iterations
from freerein_orchestrator.ppo_training import Outset, PPOTraining, roll_out
from freerein_orchestrator.rejection import Rejected
from freerein_orchestrator.rollout import Rewards, Rollout, Step
from freerein_orchestrator.served import ServedEnvironments, split

pytestmark = pytest.mark.e2e
CPU = torch.device("cpu")
TASK, CAMERA, GOAL = "blocks.red-on-top-of-yellow", "front", "a red block on top of a yellow block"
FAST = PPOConfig(iterations=2, num_envs=3, steps=8, epochs=1, batch_size=8, hidden=8, features=8)


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any]) -> Iterator[SyncClient]:
    with SyncClient(SimClient(Channel(start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1").address))) as sim:
        yield sim


@pytest.fixture(scope="module")
def reward(start_module_service: Callable[..., Any]) -> Iterator[SyncClient]:
    with SyncClient(RewardClient(Channel(start_module_service("freerein_reward").address))) as reward:
        yield reward


def served(
    *sims: SyncClient, judge: Judge, privileged: bool = False, snapshots: Sequence[bytes] = ()
) -> ServedEnvironments:
    request = CreateSessionRequest(TASK, num_envs=3, seed=3, privileged=privileged)
    return ServedEnvironments(sims, request, camera=CAMERA, judge=judge, snapshots=snapshots)


def draw_actions(rng: np.random.Generator) -> Any:
    return rng.uniform(-1, 1, (3, 3)).astype(np.float32)


def test_what_was_reached_is_judged_also_where_an_episode_ended(sim: SyncClient, reward: SyncClient) -> None:
    environments = served(sim, judge=LearnedReward(reward, GOAL, CAMERA))
    environments.reset()
    rng, steps = np.random.default_rng(0), list[Step]()
    while not steps or not (steps[-1].terminated | steps[-1].truncated).any():
        steps.append(environments.step(draw_actions(rng)))
    reached = np.concatenate([step.final_observations for step in steps])
    expected = reward.reward(RewardRequest(GOAL, {CAMERA: reached})).rewards
    np.testing.assert_array_equal(environments.rewards(), expected.reshape(-1, 3))
    over = steps[-1].terminated | steps[-1].truncated
    assert not np.array_equal(steps[-1].final_observations[over], steps[-1].observations[over])
    environments.close()


def test_the_same_frames_are_always_judged_together(sim: SyncClient) -> None:
    sizes: list[int] = []

    def judge(reached: Frames, _oracle: Rewards | None) -> Rewards:
        sizes.append(len(reached))
        return np.zeros(len(reached), np.float32)

    environments = served(sim, judge=judge)
    environments.reset()
    for _ in range(2):
        for _ in range(25):
            environments.step(np.zeros((3, 3), np.float32))
        assert environments.rewards().shape == (25, 3)
    assert sizes == [30, 30, 15, 30, 30, 15]
    environments.close()


def test_an_unprivileged_session_answers_frames_and_nothing_else(sim: SyncClient, reward: SyncClient) -> None:
    told: list[Rewards | None] = []
    replies: list[StepResponse] = []

    def judge(reached: Frames, oracle: Rewards | None) -> Rewards:
        told.append(oracle)
        return LearnedReward(reward, GOAL, CAMERA)(reached, oracle)

    class Overheard:
        """The service, overheard."""

        def __getattr__(self, name: str) -> Callable[..., Any]:
            def call(request: Any, **kwargs: Any) -> Any:
                reply = getattr(sim, name)(request, **kwargs)
                replies.append(reply)
                return reply

            return call

    environments = served(Overheard(), judge=judge)  # type: ignore[arg-type]  # as good as the service
    environments.reset()
    environments.step(np.zeros((3, 3), np.float32))
    environments.rewards()
    environments.close()
    assert told == [None]
    assert {getattr(reply, "truth", None) for reply in replies} == {None}
    assert [reply.reward.tolist() for reply in replies if isinstance(reply, StepResponse)] == [[0.0] * 3]


def test_the_oracle_needs_a_privileged_session(sim: SyncClient) -> None:
    still = np.zeros((3, 3), np.float32)
    privileged, plain = served(sim, judge=oracle, privileged=True), served(sim, judge=oracle)
    for environments in (privileged, plain):
        environments.reset()
        environments.step(still)
    assert privileged.rewards().shape == (1, 3)
    with pytest.raises(FailedPrecondition, match="privileged"):
        plain.rewards()
    for environments in (privileged, plain):
        environments.close()


def test_environments_split_over_two_sims_are_as_many_and_differ(sim: SyncClient) -> None:
    environments = served(sim, sim, judge=oracle, privileged=True)
    frames = environments.reset()
    assert split(3, 2) == (2, 1)
    assert len({frame.tobytes() for frame in frames}) == 3
    step = environments.step(draw_actions(np.random.default_rng(0)))
    assert step.observations.shape == (3, 64, 64, 3)
    assert environments.rewards().shape == (1, 3)
    snapshots = environments.snapshots()
    expected = environments.step(np.ones((3, 3), np.float32)).observations
    again = served(sim, sim, judge=oracle, privileged=True, snapshots=snapshots)
    np.testing.assert_array_equal(again.step(np.ones((3, 3), np.float32)).observations, expected)
    for each in (environments, again):
        each.close()


def test_sessions_of_sims_that_hang_are_left_to_their_leases_at_once(start_service: Callable[..., Any]) -> None:
    service = start_service("freerein_sim", FREEREIN_SIM_WORKERS="1")
    with SyncClient(SimClient(Channel(service.address))) as sim:
        environments = served(sim, sim, sim, judge=oracle)
        service.process.send_signal(signal.SIGSTOP)
        begun = time.monotonic()
        environments.close()
        took_s = time.monotonic() - begun
        service.process.send_signal(signal.SIGCONT)
    assert took_s < 0.9


@pytest.mark.parametrize("rewards", [np.zeros(2, np.float32), np.full(24, np.nan, np.float32)])
def test_rewards_that_are_none_are_rejected(sim: SyncClient, rewards: Rewards) -> None:
    whole = served(sim, judge=lambda reached, _: np.zeros(len(reached), np.float32))
    training = begin(whole)
    environments = served(sim, judge=lambda *_: rewards, snapshots=training.outset.environments)
    with pytest.raises(Rejected, match="Rewards must be"):
        roll_out(training.actor, training.outset, environments, FAST)
    for each in (whole, environments):
        each.close()


@pytest.mark.parametrize(
    ("mode", "possible", "garbage"),
    [("binary", [0, 1, 1], [0, 0.5, 1]), ("raw", [-1, 0.3, 1], [0, 1e30, 0]), ("raw", [0, 0, 0], [0, np.nan, 0])],
)
def test_a_learned_reward_that_its_mode_cannot_come_to_is_rejected(
    mode: Mode, possible: list[float], garbage: list[float]
) -> None:
    class Service:
        """A reward service that answers what it was told."""

        def __init__(self, rewards: list[float]) -> None:
            self.rewards = np.array(rewards, np.float32)

        def reward(self, _request: RewardRequest) -> "Service":
            return self

    def judge(rewards: list[float]) -> Rewards:
        service: Any = Service(rewards)
        return LearnedReward(service, GOAL, CAMERA, mode=mode)(np.zeros((3, 4, 4, 3), np.uint8), None)

    np.testing.assert_array_equal(judge(possible), np.array(possible, np.float32))
    with pytest.raises(Rejected, match=f"mode {mode} must be"):
        judge(garbage)


def test_which_model_judges_is_pinned_and_what_it_cannot_judge_refused_at_once(reward: SyncClient) -> None:
    model = LearnedReward(reward, GOAL, CAMERA).pin(64, 64, 3)
    assert len(model.version) == 12
    assert LearnedReward(reward, GOAL, CAMERA, model).pin(64, 64, 3) == model
    one = LearnedReward(reward, GOAL, CAMERA, model)(np.zeros((1, 64, 64, 3), np.uint8), None)
    assert one.shape == (1,)
    with pytest.raises(InvalidInput, match="rivals"):
        LearnedReward(reward, "a red block", CAMERA).pin(64, 64, 3)
    with pytest.raises(FailedPrecondition, match="fitted"):
        LearnedReward(reward, GOAL, CAMERA, ModelRef("another")).pin(64, 64, 3)


def begin(environments: ServedEnvironments) -> PPOTraining:
    spec = ppo_training.design(FAST, observation=(64, 64, 3), action_size=3)
    return ppo_training.begin(FAST, spec, environments, device=CPU)


def test_a_training_goes_on_in_another_session_to_the_same_bits(sim: SyncClient, reward: SyncClient) -> None:
    judge, digests = LearnedReward(reward, GOAL, CAMERA), set()
    environments = served(sim, judge=judge)
    training = begin(environments)
    saved = ppo_training.snapshot(training)
    *_, whole = iterations(training, lambda actor, outset: roll_out(actor, outset, environments, FAST))
    digests.add(weights.sha256(whole.network))
    environments.close()

    def gather(actor: Any, outset: Outset) -> tuple[Rollout, Outset]:
        others = served(sim, judge=judge, snapshots=outset.environments)
        gathered = roll_out(actor, outset, others, FAST)
        others.close()
        return gathered

    *_, again = iterations(ppo_training.restore(saved, FAST, device=CPU), gather)
    digests.add(weights.sha256(again.network))
    assert len(digests) == 1
