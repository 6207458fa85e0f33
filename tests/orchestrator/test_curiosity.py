"""Curiosity: what it is rewarded for, what it sees, and how far it leads."""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from freerein.errors import FailedPrecondition
from freerein.learning import checkpoints, tensor_files
from freerein.learning.train_state import FitLoopState
from freerein_orchestrator import curiosity, exploration, ppo_training
from freerein_orchestrator.curiosity import Curiosity, CuriosityConfig, Transitions
from freerein_orchestrator.exploration import Exploration
from freerein_orchestrator.networks import ActorCriticSpec
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.rollout import Actions, Observations, Rewards, Step

CPU = torch.device("cpu")
CELLS = 32
SMALL = CuriosityConfig(batch_size=32, hidden=64)
PPO = PPOConfig(
    iterations=12,
    num_envs=4,
    steps=CELLS,
    batch_size=CELLS,
    lr=1e-3,
    discount=0.99,
    entropy_weight=0.01,
    overlap=False,
)


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


class Corridor:
    """A lamp in a row of cells, at the left end at first; actions move it by one. An episode is cut off at `length`."""

    def __init__(self, *, length: int = CELLS) -> None:
        self.num_envs = PPO.num_envs
        self.visited: set[int] = set()
        self._length = length
        self._at, self._age = np.zeros(self.num_envs, np.int64), 0
        self._reached: list[Observations] = []

    def reset(self) -> Observations:
        self._at, self._age = np.zeros(self.num_envs, np.int64), 0
        return lamps(self._at)

    def step(self, actions: Actions) -> Step:
        self._at = np.clip(self._at + 2 * actions[:, 0] - 1, 0, CELLS - 1)
        self._age += 1
        self.visited.update(self._at.tolist())
        self._reached.append(lamps(self._at))
        is_over = np.full(self.num_envs, self._age == self._length)
        seen = self.reset() if is_over.all() else lamps(self._at)
        return Step(seen, np.zeros(self.num_envs, np.bool_), is_over, self._reached[-1])

    def rewards(self) -> Rewards:
        return np.zeros((len(self._reached), self.num_envs), np.float32)

    def snapshots(self) -> tuple[bytes, ...]:
        return (json.dumps([self._at.tolist(), self._age]).encode(),)

    def restore(self, snapshot: bytes) -> None:
        at, self._age = json.loads(snapshot)
        self._at = np.array(at)

    def take(self) -> Tensor:
        reached, self._reached = torch.from_numpy(np.stack(self._reached)), []
        return reached


def lamps(at: "np.ndarray[tuple[int], np.dtype[np.int64]]") -> Observations:
    frames = np.full((len(at), 4, CELLS, 1), 30, np.uint8)
    frames[np.arange(len(at)), :, at] = 255
    return frames


def moves(rng: np.random.Generator, *, first: int, end: int, is_discrete: bool) -> Transitions:
    """Returns 256 moves to the left or the right that begin in some cells of the corridor."""
    at = rng.integers(first, end, 256)
    right = rng.integers(2, size=(256, 1))
    after = np.clip(at + 2 * right[:, 0] - 1, 0, CELLS - 1)
    actions = right if is_discrete else (2 * right - 1).astype(np.float32)
    return Transitions(*(torch.from_numpy(each) for each in (lamps(at), actions, lamps(after))))


def curious(seen: Transitions, *, is_discrete: bool, updates: int) -> FitLoopState[Curiosity]:
    """Returns curiosity that has learnt some transitions."""
    height, width, channels = seen.before.shape[1:]
    choices = 2 if is_discrete else 0
    spec = ActorCriticSpec(action_choices=choices, height=height, width=width, channels=channels, features=32)
    progress = curiosity.begin(SMALL, spec, transitions=len(seen), device=CPU)
    progress.state.network.image.fit_normalisation(seen.before)
    while progress.state.step < updates:
        progress, _ = curiosity.learn(progress, seen, SMALL)
    return progress


@pytest.mark.parametrize("is_discrete", [True, False])
def test_what_was_learnt_surprises_less_than_before_and_less_than_what_is_new(is_discrete: bool) -> None:
    rng = np.random.default_rng(0)
    known = moves(rng, first=1, end=CELLS // 2, is_discrete=is_discrete)
    new = moves(rng, first=CELLS // 2 + 2, end=CELLS - 1, is_discrete=is_discrete)

    progress = curious(known, is_discrete=is_discrete, updates=64)
    before = curiosity.surprise(progress.state.network, known, scale=1.0).mean()
    while progress.state.step < 192:
        progress, _ = curiosity.learn(progress, known, SMALL)
    after, elsewhere = (curiosity.surprise(progress.state.network, each, scale=1.0).mean() for each in (known, new))
    assert after < 0.5 * before
    assert elsewhere > 3 * after


def test_surprise_is_half_the_squared_error_of_what_was_foreseen_and_does_not_move_the_features() -> None:
    steps = moves(np.random.default_rng(0), first=1, end=8, is_discrete=True)
    network = curious(steps, is_discrete=True, updates=8).state.network
    before, after = network.image(steps.before), network.image(steps.after)
    foreseen = before + network.change(torch.cat([before, torch.eye(2)[steps.actions[:, 0]]], dim=-1))
    expected = 0.5 * 0.01 * (foreseen - after).square().sum(dim=-1)

    torch.testing.assert_close(curiosity.surprise(network, steps, scale=0.01), expected.detach())
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
    image = curious(seen, is_discrete=True, updates=192).state.network.image
    untaught = curious(seen, is_discrete=True, updates=0).state.network.image
    here, flickered, moved = flickering(at), flickering(at), flickering(at + 1)

    def sensitivity(features: torch.nn.Module) -> float:
        """Returns how much features change with the lamp, as a multiple of how much they do with the flicker."""
        with torch.no_grad():
            still, other, beside = features(here), features(flickered), features(moved)
        return float((still - beside).norm(dim=1).mean() / (still - other).norm(dim=1).mean())

    assert sensitivity(image) > sensitivity(untaught)


def test_curiosity_covers_more_than_random_actions_in_as_many_steps() -> None:
    environments = Corridor()
    explored = explore(begin(2, environments), environments)
    assert explored.recorded == PPO.iterations * PPO.num_envs
    assert len(environments.visited) > 1.2 * len(wandered(2))


def wandered(seed: int) -> set[int]:
    """Returns the cells that random actions lead to, in as many steps."""
    environments, rng = Corridor(), np.random.default_rng(seed)
    environments.reset()
    for _ in range(PPO.iterations * PPO.steps):
        environments.step(rng.integers(2, size=(PPO.num_envs, 1)))
    return environments.visited


@pytest.mark.parametrize("iteration", [0, 2])
def test_an_exploration_killed_between_iterations_goes_on_to_the_same_bits(tmp_path: Path, iteration: int) -> None:
    environments = Corridor(length=20)
    explored = begin(0, environments)
    for _ in range(3):
        if explored.training.iteration == iteration:
            checkpoints.save(tmp_path, exploration.snapshot(explored))
        explored = go_on(explored, environments)

    found, others = checkpoints.newest(tmp_path, on_corrupt=lambda *_: pytest.fail("damaged")), Corridor(length=20)
    assert found is not None
    training = ppo_training.restore(found, explored.training.config, device=CPU)
    again = exploration.restore(training, found, explored.config)
    others.restore(training.outset.environments[0])
    while again.training.iteration < 3:
        again = go_on(again, others)
    assert digest(again) == digest(explored)
    with pytest.raises(FailedPrecondition):
        exploration.restore(training, found, CuriosityConfig(batch_size=16))


def digest(explored: Exploration) -> str:
    """Returns the sha256 of the complete state."""
    snapshot = exploration.snapshot(explored)
    document = json.dumps(dict(snapshot.document), sort_keys=True).encode()
    return hashlib.sha256(tensor_files.dump(snapshot.tensors) + document).hexdigest()


def test_trajectories_are_cut_where_episodes_end_and_no_step_leads_from_one_to_the_next() -> None:
    environments = Corridor(length=20)
    training = begin(0, environments).training
    rollout, _ = ppo_training.roll_out(training.actor, training.outset, environments, training.config)
    reached = environments.take()
    made, steps = exploration.trajectories(rollout, "top"), exploration.transitions(rollout, reached)

    assert [len(each.actions) for each in made] == [20] * 4 + [12] * 4
    assert not made[4].frames["top"][0, 0, 1:].max() > 30  # it begins at the left end again
    env = made[1]
    np.testing.assert_array_equal(env.frames["top"], rollout.observations[:20, 1].numpy())
    np.testing.assert_array_equal(env.actions, rollout.actions[:20, 1].numpy())
    expected = (position(steps.before) + 2 * steps.actions[:, 0] - 1).clamp(0, CELLS - 1)
    torch.testing.assert_close(position(steps.after), expected)


def position(frames: Tensor) -> Tensor:
    """Returns where the lamp is, int64 (M,)."""
    return frames[:, 0, :, 0].int().argmax(dim=1)


def begin(seed: int, environments: Corridor) -> Exploration:
    config = PPOConfig(**{**vars(PPO), "seed": seed})
    spec = ppo_training.design(config, observation=(4, CELLS, 1), action_choices=2)
    training = ppo_training.begin(config, spec, environments, device=CPU)
    environments.take()
    environments.visited.clear()
    return exploration.begin(training, CuriosityConfig(seed=seed))


def explore(explored: Exploration, environments: Corridor) -> Exploration:
    """Returns an exploration at its end."""
    while explored.training.iteration < PPO.iterations:
        explored = go_on(explored, environments)
    return explored


def go_on(explored: Exploration, environments: Corridor) -> Exploration:
    training = explored.training
    rollout, outset = ppo_training.roll_out(training.actor, training.outset, environments, training.config)
    return exploration.advance(explored, rollout, environments.take(), outset)
