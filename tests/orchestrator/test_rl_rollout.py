"""Rollouts, advantages, episode statistics and reward normalisation, on scripted environments."""

import numpy as np
import pytest
import torch

from freerein.config import parse
from freerein.errors import InvalidInput
from freerein.learning.actor_critic.networks import ActorCriticSpec
from freerein_orchestrator.rewards.shaping import Shaping
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.env_groups import EnvGroups, collect_groups
from freerein_orchestrator.rl.episode_stats import EpisodeStats
from freerein_orchestrator.rl.errors import IterationRejected
from freerein_orchestrator.rl.initial_network import init_network
from freerein_orchestrator.rl.ppo import generalised_advantages, training_batch
from freerein_orchestrator.rl.return_normaliser import ReturnNormaliser
from freerein_orchestrator.rl.rollout import CollectorState, RolloutBuffer, collect
from freerein_orchestrator.rl.vec_env import Actions, Observations, Rewards, VecStep


class ScriptedEnvs:
    """Three environments, rewards of 1; at a timestep the first terminates, the second is truncated, the third both."""

    num_envs = 3

    def __init__(self, ends_at: int = 2) -> None:
        self._rng, self._t, self._ends_at = np.random.default_rng(0), 0, ends_at
        self.final = self.reset()
        self.reward, self.gives_up = 1.0, False

    def reset(self) -> Observations:
        return self._rng.standard_normal((3, 2), np.float32)

    def step(self, actions: Actions) -> VecStep:
        done = np.full(3, self._t == self._ends_at)
        self._t += 1
        self.final = self.reset() if self._t <= self._ends_at + 1 else self.final
        given_up = done & [False, True, False] if self.gives_up else None
        return VecStep(self.reset(), done & [True, False, True], done & [False, True, True], self.final, given_up)

    def rewards(self) -> Rewards:
        steps, self._t = self._t, 0
        return np.full((steps, 3), self.reward, np.float32)

    def snapshots(self) -> tuple[bytes, ...]:
        return (b"here",)

    def close(self) -> None:
        """Holds nothing."""


@pytest.mark.parametrize("recurrent", [False, True])
def test_values_are_the_networks_also_after_the_rollout_and_where_an_episode_was_truncated(recurrent: bool) -> None:
    envs, generator = ScriptedEnvs(), torch.Generator().manual_seed(0)
    network = init_network(ActorCriticSpec(vector_size=2, recurrent=recurrent), generator)
    state = CollectorState.init(envs, network, generator)
    rollout, after = collect(network, envs, state, num_steps=40)

    seen = torch.cat([rollout.observations, after.observations[None]])
    starts = torch.cat([rollout.episode_starts, after.episode_starts[None]])
    until_truncation = torch.cat([rollout.observations[:3], torch.from_numpy(envs.final)[None]])
    with torch.no_grad():
        outputs = network(seen, starts, state.recurrent_state)
        final = network(until_truncation, torch.zeros(4, 3, dtype=torch.bool), state.recurrent_state).values[3, 1]
    torch.testing.assert_close(torch.cat([rollout.values, rollout.last_values[None]]), outputs.values)
    log_probs = network(rollout.observations, rollout.episode_starts, state.recurrent_state).actions.log_prob
    torch.testing.assert_close(rollout.log_probs, log_probs(rollout.actions).detach())
    expected = torch.zeros(40, 3)
    expected[2, 1] = final
    torch.testing.assert_close(rollout.truncated_values, expected)

    config = PPOConfig(num_envs=3, num_steps=40, batch_size=40, recurrent=True)
    advantages = generalised_advantages(
        rollout.rewards + 0.98 * expected,
        outputs.values[:-1],
        rollout.dones,
        outputs.values[-1],
        gamma=0.98,
        gae_lambda=0.95,
    )
    torch.testing.assert_close(training_batch(rollout, rollout.rewards, config).advantages, advantages)


def test_a_rollout_tells_termination_from_truncation_and_knows_what_each_action_led_to() -> None:
    envs, generator = ScriptedEnvs(), torch.Generator().manual_seed(0)
    network = init_network(ActorCriticSpec(vector_size=2), generator)
    rollout, after = collect(network, envs, CollectorState.init(envs, network, generator), num_steps=5)
    assert rollout.dones.tolist() == [[t == 2] * 3 for t in range(5)]
    assert rollout.terminated.tolist() == [[t == 2, False, t == 2] for t in range(5)]
    assert (rollout.truncated_values != 0).tolist() == [[False, t == 2, False] for t in range(5)]
    assert rollout.episode_starts.tolist() == [[t in (0, 3)] * 3 for t in range(5)]
    assert rollout.final_observations.tolist() == envs.final.tolist()
    assert rollout.next_observations[2].tolist() == envs.final.tolist()
    assert torch.equal(rollout.next_observations[[0, 1, 3]], rollout.observations[[1, 2, 4]])
    assert torch.equal(rollout.next_observations[4], after.observations)

    assert not rollout.given_up.any()
    episodes, ended = EpisodeStats.init(3).update(rollout.rewards, rollout.dones, rollout.given_up)
    assert (ended.returns.tolist(), ended.lengths.tolist()) == ([3.0] * 3, [3] * 3)
    assert (episodes.returns.tolist(), episodes.lengths.tolist()) == ([2.0] * 3, [2] * 3)
    assert ended.metrics() == {"episode_return": 3.0, "episode_length": 3.0}
    assert ended.metrics(action_repeat=2) == {"episode_return": 3.0, "episode_length": 6.0}
    assert EpisodeStats.init(0).metrics() == {}


def test_an_episode_that_is_given_up_has_no_return_and_the_next_one_begins_at_zero() -> None:
    envs, generator = ScriptedEnvs(), torch.Generator().manual_seed(0)
    network = init_network(ActorCriticSpec(vector_size=2), generator)
    envs.gives_up = True
    rollout, _ = collect(network, envs, CollectorState.init(envs, network, generator), num_steps=5)

    episodes, ended = EpisodeStats.init(3).update(rollout.rewards, rollout.dones, rollout.given_up)

    assert rollout.given_up.tolist() == [[False, t == 2, False] for t in range(5)]
    assert (ended.returns.tolist(), ended.lengths.tolist()) == ([3.0] * 2, [3] * 2)
    assert (episodes.returns.tolist(), episodes.lengths.tolist()) == ([2.0] * 3, [2] * 3)


def test_shaping_adds_to_the_return_of_an_episode_only_what_its_ends_are_worth() -> None:
    envs, generator = ScriptedEnvs(), torch.Generator().manual_seed(0)
    network = init_network(ActorCriticSpec(vector_size=2), generator)
    rollout, _ = collect(network, envs, CollectorState.init(envs, network, generator), num_steps=5)

    shaping = Shaping(lambda observations: observations[..., 0], 0.9).rewards(rollout)

    returns = (shaping[:3] * 0.9 ** torch.arange(3)[:, None]).sum(dim=0)  # each episode ends after three timesteps
    first, last = rollout.observations[0, :, 0], torch.from_numpy(envs.final)[:, 0]
    is_truncated = torch.tensor([0.0, 1.0, 0.0])
    torch.testing.assert_close(returns, 0.9**3 * last * is_truncated - first)


def test_what_shapes_stays_as_it_was_where_it_is_not_known() -> None:
    envs, generator = ScriptedEnvs(), torch.Generator().manual_seed(0)
    network = init_network(ActorCriticSpec(vector_size=2), generator)
    rollout, _ = collect(network, envs, CollectorState.init(envs, network, generator), num_steps=5)

    def never(observations: torch.Tensor) -> torch.Tensor:
        return torch.zeros(observations.shape[:-1], dtype=torch.bool)

    shaping = Shaping(lambda observations: observations[..., 0], 0.9, never).rewards(rollout)

    first, second = rollout.observations[0, :, 0], rollout.observations[3, :, 0]  # of two episodes
    torch.testing.assert_close(shaping[:2], -0.1 * first.expand(2, -1))
    torch.testing.assert_close(shaping[3:], -0.1 * second.expand(2, -1))
    torch.testing.assert_close(shaping[2], (0.9 * torch.tensor([0.0, 1.0, 0.0]) - 1) * first)  # two are terminated


def test_groups_of_environments_are_collected_as_one_rollout() -> None:
    generator = torch.Generator().manual_seed(0)
    network = init_network(ActorCriticSpec(vector_size=2), generator)

    def collected() -> tuple[RolloutBuffer, CollectorState, EnvGroups[ScriptedEnvs]]:
        envs, same = EnvGroups([ScriptedEnvs(ends_at=3), ScriptedEnvs(ends_at=1)]), torch.Generator().manual_seed(1)
        return *collect_groups(network, envs, CollectorState.init(envs, network, same), num_steps=5), envs

    (rollout, after, envs), (again, _, _) = collected(), collected()

    assert torch.equal(rollout.actions, again.actions)
    assert not torch.equal(rollout.actions[:, :3], rollout.actions[:, 3:])
    assert rollout.dones.tolist() == [[t == 3] * 3 + [t == 1] * 3 for t in range(5)]
    assert rollout.final_observations.tolist() == [*envs.groups[1].final.tolist(), *envs.groups[0].final.tolist()]
    assert torch.equal(rollout.next_observations[4], after.observations)
    assert torch.equal(rollout.next_observations[0], rollout.observations[1])
    assert after.env_snapshots == (b"here", b"here")


def test_rewards_that_are_not_finite_reject_the_iteration() -> None:
    envs, generator = ScriptedEnvs(), torch.Generator().manual_seed(0)
    network = init_network(ActorCriticSpec(vector_size=2), generator)
    envs.reward = np.nan
    with pytest.raises(IterationRejected, match="finite"):
        collect(network, envs, CollectorState.init(envs, network, generator), num_steps=5)


def test_normalised_rewards_do_not_depend_on_the_unit_and_are_scaled_by_the_std_of_discounted_returns() -> None:
    rng = np.random.default_rng(0)
    rewards, dones = rng.standard_normal((50, 4)).astype(np.float32), np.zeros((50, 4), np.bool_)
    dones[10:40:7] = True
    scaled, state = ReturnNormaliser.init(4).normalise(torch.from_numpy(rewards), torch.from_numpy(dones), gamma=0.9)
    other, _ = ReturnNormaliser.init(4).normalise(64 * torch.from_numpy(rewards), torch.from_numpy(dones), gamma=0.9)
    torch.testing.assert_close(scaled, other)

    returns, seen = np.zeros(4), []
    for reward, done in zip(rewards, dones, strict=True):
        returns = 0.9 * returns + reward
        seen.append(returns)
        returns = returns * ~done
    assert state.moments[0] == 200
    torch.testing.assert_close(scaled[-1], torch.from_numpy(rewards[-1] / np.std(seen)).float())


@pytest.mark.parametrize(
    "values",
    [
        {"batch_size": 100},
        {"batch_size": 16, "recurrent": True},
        {"num_envs": 1024, "num_steps": 256},
        {"clip_range": 0.0},
        {"discount": 0.9},
    ],
)
def test_an_invalid_configuration_is_refused(values: dict[str, object]) -> None:
    assert parse(PPOConfig, {"num_steps": 32.0}).steps_per_iteration == 20
    with pytest.raises(InvalidInput):
        parse(PPOConfig, values)
