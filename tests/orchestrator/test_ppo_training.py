import hashlib
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from freerein.errors import FailedPrecondition, InvalidInput
from freerein.learning import checkpoints, tensor_files, weights
from freerein_orchestrator import ppo_training
from freerein_orchestrator.hindsight import reconsider
from freerein_orchestrator.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.patience import Stopped
from freerein_orchestrator.ppo import estimate_advantages, prepare
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.ppo_loop import Gather, iterations
from freerein_orchestrator.ppo_training import Outset, PPOTraining, roll_out
from freerein_orchestrator.rejection import Rejected
from freerein_orchestrator.reward_scale import RewardScale
from freerein_orchestrator.rollout import (
    Actions,
    Environments,
    Observations,
    Rewards,
    Rollout,
    Standing,
    Step,
    collect,
)
from freerein_orchestrator.tally import Tally

CPU = torch.device("cpu")
FRAME = (12, 12, 1)
FRAMES = PPOConfig(
    iterations=12,
    num_envs=8,
    steps=32,
    batch_size=64,
    lr=2e-3,
    discount=0.5,
    entropy_weight=0.005,
    scale_rewards=False,
    features=16,
    hidden=16,
)


class KeptRewards:
    """Rewards that are kept until they are asked for, in environments that nothing brings back."""

    def __init__(self) -> None:
        self.kept: list[Rewards] = []

    def rewards(self) -> Rewards:
        kept, self.kept = np.stack(self.kept), []
        return kept

    def snapshots(self) -> tuple[bytes, ...]:
        return ()


class DotEnvironments(KeptRewards):
    """A dot at the left or the right of a frame moves at random; an action towards its side is worth 1, others 0.

    Episodes end by chance, or are cut off after 10 timesteps.
    """

    def __init__(self, num_envs: int, seed: int) -> None:
        super().__init__()
        self._rng = np.random.default_rng(seed)
        self._is_right = np.zeros(num_envs, np.bool_)
        self._ages = np.zeros(num_envs, np.int64)

    @property
    def num_envs(self) -> int:
        return len(self._ages)

    def reset(self) -> Observations:
        self._ages[:] = 0
        return self._move()

    def step(self, actions: Actions) -> Step:
        self.kept.append(((actions[:, 0] > 0) == self._is_right).astype(np.float32))
        self._ages += 1
        terminated, truncated = self._rng.random(self.num_envs) < 0.05, self._ages >= 10
        final = self._move()
        self._ages[terminated | truncated] = 0
        return Step(self._move(), terminated, truncated, final)

    def snapshots(self) -> tuple[bytes, ...]:
        state = self._rng.bit_generator.state, self._is_right.tolist(), self._ages.tolist()
        return (json.dumps(state).encode(),)

    def restore(self, snapshots: tuple[bytes, ...]) -> None:
        self._rng.bit_generator.state, is_right, ages = json.loads(snapshots[0])
        self._is_right, self._ages, self.kept = np.array(is_right), np.array(ages), []

    def gather(self, config: PPOConfig) -> Gather:
        """Returns what collects from here, wherever these stand."""

        def gather(actor: ActorCritic, outset: Outset) -> tuple[Rollout, Outset]:
            self.restore(outset.environments)
            return roll_out(actor, outset, self, config)

        return gather

    def _move(self) -> Observations:
        self._is_right = self._rng.random(self.num_envs) < 0.5
        frames = self._rng.integers(90, 110, (self.num_envs, *FRAME), np.uint8)
        frames[np.arange(self.num_envs), 4:8, np.where(self._is_right, 9, 2)] = 255
        return frames


def begin(config: PPOConfig, environments: Environments) -> PPOTraining:
    return ppo_training.begin(config, ppo_training.design(config, observation=FRAME), environments, device=CPU)


def test_what_to_do_is_learnt_from_frames() -> None:
    environments = DotEnvironments(8, seed=0)
    made = list(iterations(begin(FRAMES, environments), environments.gather(FRAMES)))
    rewards = [each.metrics["episode_return"] / each.metrics["episode_length"] for each in made]
    assert made[-1].iteration == FRAMES.iterations
    assert rewards[0] < 0.65
    assert rewards[-1] > 0.9


@pytest.mark.parametrize(("overlap", "is_recurrent"), [(False, False), (True, True)])
def test_a_training_killed_between_any_two_iterations_ends_at_the_same_bits(
    tmp_path: Path, overlap: bool, is_recurrent: bool
) -> None:
    config = replace(FRAMES, iterations=4, steps=16, overlap=overlap, is_recurrent=is_recurrent, scale_rewards=True)
    environments = DotEnvironments(8, seed=0)
    begun = begin(config, environments)
    checkpoints.save(tmp_path / "0", ppo_training.snapshot(begun))
    for whole in iterations(begun, environments.gather(config)):
        checkpoints.save(tmp_path / str(whole.iteration), ppo_training.snapshot(whole))

    for iteration in range(4):
        again = _finish(config, tmp_path / str(iteration))
        assert weights.sha256(again.network) == weights.sha256(whole.network)
        assert _digest(again) == _digest(whole)


def _finish(config: PPOConfig, folder: Path) -> PPOTraining:
    """Returns a training gone on with from a checkpoint to its end, by objects of its own."""
    found = checkpoints.newest(folder, on_corrupt=lambda *_: pytest.fail("damaged"))
    assert found is not None
    training = ppo_training.restore(found, config, device=CPU)
    *_, last = iterations(training, DotEnvironments(8, seed=99).gather(config))
    return last


def _digest(training: PPOTraining) -> str:
    """Returns the sha256 of the complete state."""
    snapshot = ppo_training.snapshot(training)
    document = json.dumps(dict(snapshot.document), sort_keys=True).encode()
    return hashlib.sha256(tensor_files.dump(snapshot.tensors) + document).hexdigest()


def test_the_bits_do_not_depend_on_whether_acting_or_learning_is_faster() -> None:
    class Slow(DotEnvironments):
        def step(self, actions: Actions) -> Step:
            torch.randn(80, 80) @ torch.randn(80, 80)
            return super().step(actions)

    config = replace(FRAMES, iterations=3, steps=16)
    digests = set()
    for kind in (DotEnvironments, DotEnvironments, Slow):
        environments = kind(8, seed=0)
        *_, last = iterations(begin(config, environments), environments.gather(config))
        digests.add(_digest(last))
    assert len(digests) == 1


def test_the_actor_is_one_iteration_behind_only_when_it_acts_while_the_learner_learns() -> None:
    for overlap in (False, True):
        config, environments = replace(FRAMES, iterations=3, steps=16, overlap=overlap), DotEnvironments(8, seed=0)
        begun = begin(config, environments)
        learnt = [weights.sha256(begun.network)]
        for training in iterations(begun, environments.gather(config)):
            learnt.append(weights.sha256(training.network))
            if training.iteration < config.iterations:
                assert weights.sha256(training.actor) == learnt[-2 if overlap else -1]


@pytest.mark.parametrize("overlap", [False, True])
def test_an_iteration_whose_rewards_are_not_finite_is_rejected_and_what_was_saved_goes_on_to_the_same_bits(
    overlap: bool,
) -> None:
    class Broken(DotEnvironments):
        def rewards(self) -> Rewards:
            return np.full_like(super().rewards(), np.nan)

    config, whole = replace(FRAMES, iterations=3, steps=16, overlap=overlap), DotEnvironments(8, seed=0)
    training = begin(config, whole)
    saved = ppo_training.snapshot(training)
    with pytest.raises(Rejected, match="finite"):
        list(iterations(training, Broken(8, seed=0).gather(config)))
    again = ppo_training.restore(saved, config, device=CPU)
    *_, last = iterations(again, whole.gather(config))
    *_, undisturbed = iterations(begin(config, other := DotEnvironments(8, seed=0)), other.gather(config))
    assert _digest(last) == _digest(undisturbed)


def test_a_learner_whose_numbers_are_not_finite_is_rejected() -> None:
    class Huge(DotEnvironments):
        def rewards(self) -> Rewards:
            return np.full_like(super().rewards(), 1e38)

    environments = Huge(8, seed=0)
    with pytest.raises(Rejected, match="policy_loss became nan"):
        list(iterations(begin(FRAMES, environments), environments.gather(FRAMES)))


def test_a_training_stops_while_it_acts_and_while_it_learns() -> None:
    for asked in (3, 40):
        calls = iter(range(asked))

        def interrupt(calls: Iterator[int] = calls) -> None:
            if next(calls, None) is None:
                raise Stopped

        environments = DotEnvironments(8, seed=0)
        with pytest.raises(Stopped):
            list(iterations(begin(FRAMES, environments), environments.gather(FRAMES), interrupt=interrupt))


def test_a_snapshot_is_not_restored_to_another_configuration() -> None:
    training = replace(begin(FRAMES, DotEnvironments(8, seed=0)), terms={"sims": 1, "camera": "front"})
    snapshot = ppo_training.snapshot(training)
    with pytest.raises(FailedPrecondition, match=r"clip was 0\.2 and is 0\.3, terms.sims was 1 and is 2"):
        ppo_training.restore(snapshot, replace(FRAMES, clip=0.3), device=CPU, terms={"sims": 2})


class ScriptedEnvironments(KeptRewards):
    """Three environments, rewards of 1: the first ends at timestep 2, the second is cut off there, the third both."""

    num_envs = 3

    def __init__(self) -> None:
        super().__init__()
        self._rng, self._t = np.random.default_rng(0), 0
        self.final = self.reset()

    def reset(self) -> Observations:
        return self._rng.standard_normal((3, 2), np.float32)

    def step(self, actions: Actions) -> Step:
        is_over = np.full(3, self._t == 2)
        self._t += 1
        self.final = self.reset() if self._t <= 3 else self.final
        self.kept.append(np.ones(3, np.float32))
        terminated, truncated = is_over & [True, False, True], is_over & [False, True, True]
        return Step(self.reset(), terminated, truncated, self.final)


@pytest.mark.parametrize("is_recurrent", [False, True])
def test_every_value_is_the_learners_also_at_the_end_of_a_rollout_and_where_an_episode_was_cut_off(
    is_recurrent: bool,
) -> None:
    environments, generator = ScriptedEnvironments(), torch.Generator().manual_seed(0)
    actor, learner = (ActorCritic(ActorCriticSpec(vector_size=2, is_recurrent=is_recurrent)) for _ in range(2))
    for network in (actor, learner):
        weights.initialise(network, generator=generator)
    standing = Standing.begin(environments.reset(), actor.spec, Tally.begin(3, scale=None))
    rollout, after = collect(actor, environments, standing, steps=400, discount=0.9, generator=generator)
    made = reconsider(rollout, learner)

    seen = torch.cat([rollout.observations, after.observations[None]])
    lived = torch.cat([rollout.observations[:3], torch.from_numpy(environments.final)[None]])
    with torch.no_grad():
        outputs = learner(seen, torch.cat([rollout.starts, after.starts[None]]), standing.memory)
        beyond = learner(lived, torch.zeros(4, 3, dtype=torch.bool), standing.memory).values[3, 1]
        log_probs = learner(rollout.observations, rollout.starts, standing.memory).actions.log_prob(rollout.actions)
    torch.testing.assert_close(torch.cat([made.values, made.next_values[None]]), outputs.values)
    torch.testing.assert_close(made.log_probs, log_probs)
    expected = torch.zeros(400, 3)
    expected[2, 1] = beyond
    torch.testing.assert_close(made.cut_values, expected)

    samples = prepare(rollout, PPOConfig(num_envs=3, steps=400, batch_size=400, is_recurrent=True), learner)
    bootstrapped = rollout.rewards + 0.98 * expected
    advantages = estimate_advantages(
        bootstrapped, outputs.values[:-1], rollout.ends, outputs.values[-1], discount=0.98, trace_decay=0.95
    )
    torch.testing.assert_close(samples.advantages, advantages)


def test_episodes_end_where_they_end_and_are_told_apart_from_those_cut_off() -> None:
    network, environments = ActorCritic(ActorCriticSpec(vector_size=2)), ScriptedEnvironments()
    generator = torch.Generator().manual_seed(0)
    weights.initialise(network, generator=generator)
    standing = Standing.begin(environments.reset(), network.spec, Tally.begin(3, scale=None))
    rollout, after = collect(network, environments, standing, steps=5, discount=0.9, generator=generator)
    assert rollout.ends.tolist() == [[t == 2] * 3 for t in range(5)]
    assert rollout.cuts.tolist() == [[False, t == 2, False] for t in range(5)]
    assert rollout.cut_observations.tolist() == [environments.final[1].tolist()]
    assert rollout.starts.tolist() == [[t in (0, 3)] * 3 for t in range(5)]
    assert rollout.rewards.tolist() == [[1.0] * 3] * 5
    assert (rollout.returns.tolist(), rollout.lengths.tolist()) == ([3.0] * 3, [3] * 3)
    assert after.tally.lengths.tolist() == [2] * 3


class CueEnvironments(KeptRewards):
    """A cue, +1 or -1, is seen once; three timesteps later naming it is worth 1, anything else 0."""

    def __init__(self, num_envs: int, seed: int) -> None:
        super().__init__()
        self._rng = np.random.default_rng(seed)
        self._cues, self._t = np.zeros(num_envs), 0

    @property
    def num_envs(self) -> int:
        return len(self._cues)

    def reset(self) -> Observations:
        self._cues, self._t = self._rng.choice([-1.0, 1.0], self.num_envs), 0
        return self._seen()

    def step(self, actions: Actions) -> Step:
        is_last, self._t = self._t == 3, self._t + 1
        self.kept.append((is_last & ((actions[:, 0] == 1) == (self._cues > 0))).astype(np.float32))
        seen = self.reset() if is_last else self._seen()
        return Step(seen, np.full(self.num_envs, is_last), np.zeros(self.num_envs, np.bool_), seen)

    def _seen(self) -> Observations:
        cues = self._cues if self._t == 0 else np.zeros_like(self._cues)
        return np.stack([cues, np.full_like(cues, self._t == 3)], axis=1).astype(np.float32)


@pytest.mark.parametrize(("is_recurrent", "least", "most"), [(True, 0.95, 1.0), (False, 0.3, 0.7)])
def test_what_must_be_remembered_is_learnt_with_a_memory_only(is_recurrent: bool, least: float, most: float) -> None:
    config = PPOConfig(
        iterations=25,
        num_envs=16,
        steps=16,
        batch_size=64,
        lr=1e-2,
        scale_rewards=False,
        hidden=16,
        is_recurrent=is_recurrent,
    )
    environments = CueEnvironments(16, seed=0)
    spec = ppo_training.design(config, observation=(2,), action_choices=2)
    training = ppo_training.begin(config, spec, environments, device=CPU)
    made = iterations(training, lambda actor, at: roll_out(actor, at, environments, config))
    returns = [each.metrics["episode_return"] for each in made]
    assert least <= np.mean(returns[-3:]) <= most


def test_a_reward_scale_does_not_depend_on_the_unit_of_rewards() -> None:
    rng, scales = np.random.default_rng(0), [RewardScale.begin(4), RewardScale.begin(4)]
    for _ in range(50):
        rewards, ends = (
            torch.from_numpy(rng.standard_normal(4).astype(np.float32)),
            torch.from_numpy(rng.random(4) < 0.1),
        )
        scales = [
            scale.observe(unit * rewards, discount=0.9).end(ends) for scale, unit in zip(scales, (1, 64), strict=True)
        ]
    torch.testing.assert_close(scales[0].apply(rewards), scales[1].apply(64 * rewards))
    assert scales[0].moments[0] == 200


def test_a_reward_scale_is_the_spread_of_all_discounted_sums() -> None:
    rng, scale, sums, seen = np.random.default_rng(0), RewardScale.begin(4), np.zeros(4), []
    for rewards in rng.standard_normal((50, 4)).astype(np.float32):
        scale, sums = scale.observe(torch.from_numpy(rewards), discount=0.9), 0.9 * sums + rewards
        seen.append(sums)
    expected = torch.tensor([0.5]) / np.std(seen)
    torch.testing.assert_close(scale.apply(torch.tensor([0.5])), expected.float())


@pytest.mark.parametrize(
    "values",
    [
        {"batch_size": 100},
        {"batch_size": 16, "is_recurrent": True},
        {"num_envs": 1024, "steps": 256},
        {"clip": 0.0},
        {"gamma": 0.9},
    ],
)
def test_a_configuration_that_cannot_be_is_refused(values: dict[str, object]) -> None:
    assert PPOConfig.from_mapping({"steps": 64.0}).updates == 16
    with pytest.raises(InvalidInput):
        PPOConfig.from_mapping(values)


def test_environments_that_do_not_fit_the_training_are_refused() -> None:
    with pytest.raises(InvalidInput, match="8 environments; got 4"):
        begin(FRAMES, DotEnvironments(4, seed=0))
    spec = ppo_training.design(FRAMES, observation=(24, 24, 1))
    with pytest.raises(InvalidInput, match="uint8"):
        ppo_training.begin(FRAMES, spec, DotEnvironments(8, seed=0), device=CPU)
