"""Curiosity: what it is rewarded for, what it sees, and how far it leads."""

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from freerein.errors import FailedPrecondition
from freerein.learning import checkpoints, tensor_files
from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein.learning.train_state import FitLoopState
from freerein_orchestrator.kinds.collect.curiosity import trajectories
from freerein_orchestrator.rewards.curiosity import CuriosityReward
from freerein_orchestrator.rewards.novelty import NoveltyReward
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.errors import Stopped
from freerein_orchestrator.rl.icm import (
    ICM,
    ICMConfig,
    Transitions,
    init_icm,
    intrinsic_rewards,
    update_icm,
)
from freerein_orchestrator.rl.initial_network import network_spec
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.rollout import CollectorState, RolloutBuffer, collect
from freerein_orchestrator.rl.state import MakeRewards, PPOState, from_checkpoint, init_state, to_checkpoint
from freerein_orchestrator.rl.trainer import Trainer
from freerein_orchestrator.rl.vec_env import Actions, Observations, Rewards, VecStep

CPU = torch.device("cpu")
CELLS = 32
SMALL = ICMConfig(batch_size=32, hidden_size=64)
PPO = PPOConfig(
    iterations=6,
    num_envs=4,
    num_steps=CELLS,
    epochs=2,
    batch_size=CELLS,
    gamma=0.99,
    ent_coef=0.01,
    hidden_size=64,
    layer_norm=False,
)


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


class Corridor:
    """A lamp in a row of cells, at first at the left end, moved by actions. Episodes are truncated at `length`."""

    num_envs = PPO.num_envs

    def __init__(self, *, length: int = CELLS) -> None:
        self.visited: set[int] = set()
        self._length = length
        self._at, self._age, self._steps = np.zeros(self.num_envs, np.int64), 0, 0

    def reset(self) -> Observations:
        self._at, self._age = np.zeros(self.num_envs, np.int64), 0
        return lamps(self._at)

    def step(self, actions: Actions) -> VecStep:
        self._at = np.clip(self._at + 2 * actions[:, 0] - 1, 0, CELLS - 1)
        self._age, self._steps = self._age + 1, self._steps + 1
        self.visited.update(self._at.tolist())
        final, truncated = lamps(self._at), np.full(self.num_envs, self._age == self._length)
        observations = self.reset() if truncated.all() else final
        return VecStep(observations, np.zeros(self.num_envs, np.bool_), truncated, final)

    def rewards(self) -> Rewards:
        steps, self._steps = self._steps, 0
        return np.zeros((steps, self.num_envs), np.float32)

    def snapshots(self) -> tuple[bytes, ...]:
        return (json.dumps([self._at.tolist(), self._age]).encode(),)

    def restore(self, snapshot: bytes) -> None:
        at, self._age = json.loads(snapshot)
        self._at = np.array(at)


class CorridorCollector:
    """Collects from a corridor."""

    recoveries = 0

    def __init__(self, envs: Corridor) -> None:
        self._envs = envs

    def collect(self, network: ActorCritic, state: CollectorState) -> tuple[RolloutBuffer, CollectorState]:
        self._envs.restore(state.env_snapshots[0])
        return collect(network, self._envs, state, num_steps=PPO.num_steps)

    def close(self) -> None:
        """Holds nothing."""


class NoLog:
    """Drops metrics."""

    def append(self, step: int, metrics: object) -> None:
        """Drops a row."""

    def close(self) -> None:
        """Holds nothing."""


def lamps(at: "np.ndarray[tuple[int], np.dtype[np.int64]]") -> Observations:
    frames = np.full((len(at), 4, CELLS, 1), 30, np.uint8)
    frames[np.arange(len(at)), :, at] = 255
    return frames


def moves(rng: np.random.Generator, *, first: int, end: int, discrete: bool) -> Transitions:
    """Returns 256 moves to the left or the right that start in some cells of the corridor."""
    at = rng.integers(first, end, 256)
    right = rng.integers(2, size=(256, 1))
    after = np.clip(at + 2 * right[:, 0] - 1, 0, CELLS - 1)
    actions = right if discrete else (2 * right - 1).astype(np.float32)
    return Transitions(*(torch.from_numpy(each) for each in (lamps(at), actions, lamps(after))))


def trained(seen: Transitions, *, discrete: bool, updates: int) -> FitLoopState[ICM]:
    """Returns a module trained on some transitions."""
    height, width, channels = seen.observations.shape[1:]
    choices = 2 if discrete else 0
    spec = ActorCriticSpec(action_choices=choices, height=height, width=width, channels=channels, feature_size=32)
    learner = init_icm(SMALL, spec, transitions=len(seen), device=CPU)
    learner.state.network.image.fit_normalisation(seen.observations)
    while learner.state.step < updates:
        learner, _ = update_icm(learner, seen, SMALL)
    return learner


@pytest.mark.parametrize("discrete", [True, False])
def test_transitions_that_were_trained_on_earn_less_than_before_and_less_than_new_ones(discrete: bool) -> None:
    rng = np.random.default_rng(0)
    known = moves(rng, first=1, end=CELLS // 2, discrete=discrete)
    new = moves(rng, first=CELLS // 2 + 2, end=CELLS - 1, discrete=discrete)

    learner = trained(known, discrete=discrete, updates=64)
    before = intrinsic_rewards(learner.state.network, known, scale=1.0).mean()
    while learner.state.step < 192:
        learner, _ = update_icm(learner, known, SMALL)
    after, elsewhere = (intrinsic_rewards(learner.state.network, each, scale=1.0).mean() for each in (known, new))
    assert after < 0.5 * before
    assert elsewhere > 3 * after


def test_the_reward_is_half_the_squared_forward_error_and_does_not_train_the_features() -> None:
    steps = moves(np.random.default_rng(0), first=1, end=8, discrete=True)
    network = trained(steps, discrete=True, updates=8).state.network
    before, after = network.image(steps.observations), network.image(steps.next_observations)
    predicted = before + network.change(torch.cat([before, torch.eye(2)[steps.actions[:, 0]]], dim=-1))
    expected = 0.5 * 0.01 * (predicted - after).square().sum(dim=-1)

    torch.testing.assert_close(intrinsic_rewards(network, steps, scale=0.01), expected.detach())
    network.zero_grad()
    network(steps)[1].sum().backward()
    assert all(parameter.grad is None for parameter in network.image.parameters())


def test_features_keep_what_actions_move_rather_than_what_flickers() -> None:
    rng = np.random.default_rng(0)
    at, right = rng.integers(1, CELLS - 1, 256), rng.integers(2, size=(256, 1))

    def flickering(cells: "np.ndarray[tuple[int], np.dtype[np.int64]]") -> Tensor:
        flicker = np.repeat(rng.integers(0, 256, (len(cells), 4, 4, 1), np.uint8), CELLS // 4, axis=2)
        return torch.from_numpy(np.concatenate([lamps(cells), flicker], axis=1))

    seen = Transitions(flickering(at), torch.from_numpy(right), flickering(at + 2 * right[:, 0] - 1))
    image = trained(seen, discrete=True, updates=96).state.network.image
    untrained = trained(seen, discrete=True, updates=0).state.network.image
    here, flickered, moved = flickering(at), flickering(at), flickering(at + 1)

    def sensitivity(features: torch.nn.Module) -> float:
        """Returns how much features change with the lamp, as a multiple of how much they do with the flicker."""
        with torch.no_grad():
            still, other, beside = features(here), features(flickered), features(moved)
        return float((still - beside).norm(dim=1).mean() / (still - other).norm(dim=1).mean())

    assert sensitivity(image) > sensitivity(untrained)


@pytest.mark.parametrize("reward", ["curiosity", "novelty"])
def test_exploration_covers_more_than_random_actions_in_as_many_steps(tmp_path: Path, reward: str) -> None:
    envs = Corridor()
    explore(tmp_path, envs, make_rewards=REWARDS[reward])
    assert len(envs.visited) > 1.2 * len(visited_at_random(0))  # without the intrinsic reward, 1.0


def visited_at_random(seed: int) -> set[int]:
    """Returns the cells that random actions lead to, in as many steps."""
    envs, rng = Corridor(), np.random.default_rng(seed)
    envs.reset()
    for _ in range(PPO.iterations * PPO.num_steps):
        envs.step(rng.integers(2, size=(PPO.num_envs, 1)))
    return envs.visited


@pytest.mark.parametrize("reward", ["curiosity", "novelty"])
def test_an_exploration_stopped_between_iterations_resumes_to_the_same_bits(tmp_path: Path, reward: str) -> None:
    short, left, make_rewards = replace(PPO, iterations=2), iter(range(8)), REWARDS[reward]

    def interrupt() -> None:
        if next(left, None) is None:
            raise Stopped

    with pytest.raises(Stopped):
        explore(tmp_path / "stopped", Corridor(length=20), config=short, interrupt=interrupt, make_rewards=make_rewards)
    found = checkpoints.newest(tmp_path / "stopped" / "checkpoints", on_corrupt=lambda *_: pytest.fail("damaged"))
    assert found is not None
    resumed, undisturbed = (
        explore(tmp_path / name, Corridor(length=20), config=short, make_rewards=make_rewards)
        for name in ("stopped", "undisturbed")
    )
    assert digest(resumed) == digest(undisturbed)
    with pytest.raises(FailedPrecondition):
        from_checkpoint(found, resumed.config, device=CPU, make_rewards=curiosity(ICMConfig(batch_size=16)))


def test_a_rollout_becomes_trajectories_within_episodes_and_transitions_that_do_not_cross_them() -> None:
    envs = Corridor(length=20)
    state = corridor_state(envs)
    rollout, _ = CorridorCollector(envs).collect(state.network, state.collector)
    rollout = replace(rollout, terminated=rollout.dones)
    made, steps = trajectories(rollout, "top"), Transitions.of(rollout)

    assert [len(each.actions) for each in made] == [20] * 4 + [12] * 4
    assert not made[4].frames["top"][0, 0, 1:].max() > 30  # it starts at the left end again
    np.testing.assert_array_equal(made[1].frames["top"], rollout.observations[:20, 1].numpy())
    np.testing.assert_array_equal(made[1].actions, rollout.actions[:20, 1].numpy())
    assert made[1].terminated.tolist() == [t == 19 for t in range(20)]
    assert not made[4].terminated.any()  # the rollout ended, not the episode
    expected = (position(steps.observations) + 2 * steps.actions[:, 0] - 1).clamp(0, CELLS - 1)
    torch.testing.assert_close(position(steps.next_observations), expected)


def position(frames: Tensor) -> Tensor:
    """Returns where the lamp is, int64 (M,)."""
    return frames[:, 0, :, 0].int().argmax(dim=1)


def curiosity(config: ICMConfig) -> MakeRewards:
    return lambda policy, _: (CuriosityReward(config, policy, transitions=PPO.rollout_size),)


def novelty(policy: ActorCritic, _: object) -> tuple[Reward, ...]:
    return (NoveltyReward(0, policy, num_envs=PPO.num_envs, transitions=PPO.rollout_size),)


REWARDS: dict[str, MakeRewards] = {"curiosity": curiosity(ICMConfig()), "novelty": novelty}


def corridor_state(
    envs: Corridor, config: PPOConfig = PPO, make_rewards: MakeRewards = REWARDS["curiosity"]
) -> PPOState:
    spec = network_spec(config, observation=(4, CELLS, 1), action_choices=2)
    state = init_state(config, spec, envs, device=CPU, make_rewards=make_rewards)
    envs.visited.clear()
    return state


def explore(
    folder: Path,
    envs: Corridor,
    *,
    make_rewards: MakeRewards,
    config: PPOConfig = PPO,
    interrupt: Callable[[], None] = lambda: None,
) -> PPOState:
    """Explores a corridor to the end, or resumes."""
    return Trainer(
        folder,
        init=lambda: corridor_state(envs, config, make_rewards),
        load=lambda found: from_checkpoint(found, config, device=CPU, make_rewards=make_rewards),
        collector=lambda _: CorridorCollector(envs),
        metrics_log=lambda _: NoLog(),
        interrupt=interrupt,
    ).train()


def digest(state: PPOState) -> str:
    """Returns the sha256 of the complete state."""
    checkpoint = to_checkpoint(state)
    document = json.dumps(dict(checkpoint.document), sort_keys=True).encode()
    return hashlib.sha256(tensor_files.dump(checkpoint.tensors) + document).hexdigest()
