"""Rollouts: T timesteps of N environments, collected with the learner's own weights."""

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticOutput
from freerein_orchestrator.rl.vec_env import (
    VecEnv,
    VecStep,
    env_actions,
    executed_actions,
    given_up,
    observation_tensor,
    reward_tensor,
    step_observations,
)


@dataclass(frozen=True, eq=False)
class RolloutBuffer:
    """T timesteps of N environments; all on the CPU.

    Attributes:
        observations: As the network takes them, uint8 (T, N, H, W, C) or float32 (T, N, D).
        episode_starts: Whether an episode starts there, bool (T, N).
        actions: As sampled, float32 (T, N, A) or int64 (T, N, 1).
        log_probs: float32 (T, N).
        values: float32 (T, N).
        rewards: Those of the environments, float32 (T, N).
        dones: Whether an episode ended, bool (T, N).
        terminated: Whether it ended in a terminal state, not by a time limit alone, bool (T, N).
        given_up: Whether it was truncated only to begin in another state, bool (T, N).
        truncated_values: Value of the final observation of a truncated episode, 0 elsewhere, float32 (T, N).
        final_observations: Final observations of the K episodes that ended, by time and environment, (K, ...).
        last_observations: Those after the last timestep, (N, ...).
        last_values: Their values, float32 (N,).
        recurrent_state: The policy's before the first timestep, float32 (N, recurrent_size).
    """

    observations: Tensor
    episode_starts: Tensor
    actions: Tensor
    log_probs: Tensor
    values: Tensor
    rewards: Tensor
    dones: Tensor
    terminated: Tensor
    given_up: Tensor
    truncated_values: Tensor
    final_observations: Tensor
    last_observations: Tensor
    last_values: Tensor
    recurrent_state: Tensor

    @property
    def executed_actions(self) -> Tensor:
        """Actions as executed: continuous ones clipped to [-1, 1]."""
        return executed_actions(self.actions)

    @property
    def next_observations(self) -> Tensor:
        """Observations that each action led to, (T, N, ...); the final one where an episode ended."""
        following = torch.cat([self.observations[1:], self.last_observations[None]])
        following[self.dones] = self.final_observations
        return following


@dataclass(frozen=True, eq=False)
class CollectorState:
    """Everything that the next rollout depends on, besides the network; all on the CPU.

    Attributes:
        observations: Present ones as the network takes them, uint8 (N, H, W, C) or float32 (N, D).
        episode_starts: Whether an episode starts with them, bool (N,).
        recurrent_state: float32 (N, recurrent_size).
        generator: State of the generator that samples actions, uint8.
        env_snapshots: Snapshots of the environments.
    """

    observations: Tensor
    episode_starts: Tensor
    recurrent_state: Tensor
    generator: Tensor
    env_snapshots: tuple[bytes, ...]

    @classmethod
    def init(cls, envs: VecEnv, network: ActorCritic, generator: torch.Generator) -> "CollectorState":
        """Resets the environments and returns the state before the first rollout.

        Raises:
            InvalidInput: The observations are not what the network takes.
        """
        return cls(
            observations=first_observations(network, envs),
            episode_starts=torch.ones(envs.num_envs, dtype=torch.bool),
            recurrent_state=torch.zeros(envs.num_envs, network.spec.recurrent_size),
            generator=generator.get_state(),
            env_snapshots=envs.snapshots(),
        )


class Collector(Protocol):
    """Collects rollouts.

    Attributes:
        recoveries: How often a rollout was restarted after a failure.
    """

    recoveries: int

    def collect(self, network: ActorCritic, state: CollectorState) -> tuple[RolloutBuffer, CollectorState]:
        """Returns the rollout that starts at `state`, and the state after it."""

    def close(self) -> None:
        """Frees the environments."""


@torch.no_grad()
def collect(
    network: ActorCritic, envs: VecEnv, state: CollectorState, *, num_steps: int
) -> tuple[RolloutBuffer, CollectorState]:
    """Returns a rollout of `num_steps` timesteps, and the collector's state after it.

    Args:
        network: The policy; not changed.
        envs: In the state that `state.env_snapshots` restores.
        state: The collector's state before the rollout.
        num_steps: T.

    Raises:
        IterationRejected: The environments returned something malformed, or a reward is not finite.
    """
    device = next(network.parameters()).device
    generator = torch.Generator()
    generator.set_state(state.generator)
    observations, starts, recurrent_state = state.observations, state.episode_starts, state.recurrent_state
    rows: list[dict[str, Tensor]] = []
    final_observations: list[Tensor] = []
    for _ in range(num_steps):
        outputs = network(observations[None].to(device), starts[None].to(device), recurrent_state.to(device))
        actions = outputs.actions.sample(generator)  # (1, N, A)
        step = envs.step(env_actions(actions[0]))
        following, final = next_observations(network, observations, step, executed_actions(actions[0].cpu()))
        row = _row(network, outputs, actions, step, final)
        rows.append({"observations": observations, "episode_starts": starts, **row})
        final_observations.append(final)
        observations, starts, recurrent_state = following, row["dones"], outputs.recurrent_state.cpu()
    stacked = {name: torch.stack([row[name] for row in rows]) for name in rows[0]}
    rollout = RolloutBuffer(
        **stacked,
        rewards=reward_tensor(envs.rewards(), stacked["dones"].shape),
        final_observations=torch.cat(final_observations),
        last_observations=observations,
        last_values=_values(network, observations, starts, recurrent_state),
        recurrent_state=state.recurrent_state,
    )
    return rollout, CollectorState(observations, starts, recurrent_state, generator.get_state(), envs.snapshots())


def first_observations(network: ActorCritic, envs: VecEnv) -> Tensor:
    """Starts an episode in every environment; returns the first observations as the network takes them, (N, ...).

    Raises:
        InvalidInput: They are not what the network takes.
    """
    spec, num_envs = network.spec, envs.num_envs
    seen = observation_tensor(envs.reset(), spec, num_envs)
    earlier, starts = torch.zeros(num_envs, *spec.earlier_shape).byte(), torch.ones(num_envs, dtype=torch.bool)
    return network.observe(seen, torch.zeros(num_envs, spec.action_size), earlier, starts)


def next_observations(
    network: ActorCritic, observations: Tensor, step: VecStep, executed: Tensor
) -> tuple[Tensor, Tensor]:
    """Returns next and final observations of a step as the network takes them.

    Args:
        network: The policy.
        observations: Before the step, as the network took them, (N, ...).
        step: The step.
        executed: The actions that were executed, (N, A).

    Raises:
        IterationRejected: The environments returned something malformed.
    """
    following, final = step_observations(step, network.spec, len(executed))
    dones, earlier = torch.from_numpy(step.terminated | step.truncated), network.earlier_frames(observations)
    no_starts = torch.zeros(len(final), dtype=torch.bool)
    return (
        network.observe(following, executed * ~dones[:, None], earlier, dones),
        network.observe(final, executed[dones], earlier[dones], no_starts),
    )


def _row(
    network: ActorCritic, outputs: ActorCriticOutput, actions: Tensor, step: VecStep, final: Tensor
) -> dict[str, Tensor]:
    """Returns a step's entries of the rollout buffer besides observations, by attribute of `RolloutBuffer`.

    Args:
        network: The policy.
        outputs: Its answer to the observations before the step.
        actions: As sampled, (1, N, A).
        step: The step.
        final: Final observations of the episodes that ended, as the network takes them.
    """
    terminated, dones = torch.tensor(step.terminated), torch.from_numpy(step.terminated | step.truncated)
    state = outputs.recurrent_state.cpu()
    return {
        "actions": actions[0].cpu(),
        "log_probs": outputs.actions.log_prob(actions)[0].cpu(),
        "values": outputs.values[0].cpu(),
        "dones": dones,
        "terminated": terminated,
        "given_up": torch.tensor(given_up(step)),
        "truncated_values": _truncated_values(network, final, dones, dones & ~terminated, state),
    }


def _values(network: ActorCritic, observations: Tensor, starts: Tensor, recurrent_state: Tensor) -> Tensor:
    """Returns the values of one timestep's observations, float32 (N,)."""
    device = next(network.parameters()).device
    outputs = network(observations[None].to(device), starts[None].to(device), recurrent_state.to(device))
    values: Tensor = outputs.values[0].cpu()
    return values


def _truncated_values(
    network: ActorCritic, final: Tensor, dones: Tensor, truncated: Tensor, recurrent_state: Tensor
) -> Tensor:
    """Returns values of the final observations of truncated episodes, 0 elsewhere, float32 (N,)."""
    values = torch.zeros(len(dones))
    if truncated.any():
        within = truncated[dones]  # final observations are those of all ended episodes
        continuing = torch.zeros(int(truncated.sum()), dtype=torch.bool)
        values[truncated] = _values(network, final[within], continuing, recurrent_state[truncated])
    return values
