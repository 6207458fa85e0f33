"""How experience is collected from environments, wherever these are.

Actions are drawn from a generator of their own: experience is the same bits whether or not the learner is at work on
what was collected before.
"""

from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein_orchestrator.networks import ActorCritic, ActorCriticSpec, Outputs
from freerein_orchestrator.reward_scale import RewardScale

Observations: TypeAlias = npt.NDArray[np.uint8] | npt.NDArray[np.float32]
"""Of N environments: frames uint8 (N, H, W, C), or vectors float32 (N, D)."""
Actions: TypeAlias = npt.NDArray[np.float32] | npt.NDArray[np.int64]
"""Of N environments: float32 (N, A) in [-1, 1], or choices int64 (N, 1)."""


@dataclass(frozen=True, eq=False)
class Step:
    """What one step of N environments came to. Where it ended an episode, the next one has begun.

    Attributes:
        observations: Of the next timestep; where an episode ended, the first of the next one.
        rewards: float32 (N,).
        terminated: bool (N,), whether the episode came to its end: nothing is worth anything thereafter.
        truncated: bool (N,), whether it was cut off, by a limit of time: it would have gone on.
        final_observations: As `observations`, but where an episode ended its own last one; the others are not read.
    """

    observations: Observations
    rewards: npt.NDArray[np.float32]
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]
    final_observations: Observations


class Environments(Protocol):
    """N environments that step together; what is random in them is theirs."""

    @property
    def num_envs(self) -> int:
        """N."""

    def reset(self) -> Observations:
        """Begins an episode in every environment; returns their first observations."""

    def step(self, actions: Actions) -> Step:
        """Takes one action in every environment."""


@dataclass(frozen=True, eq=False)
class Standing:
    """Where the environments' episodes stand between two timesteps, as far as the actor knows; all on the CPU.

    Attributes:
        observations: The present ones, uint8 (N, H, W, C) or float32 (N, D).
        starts: Whether an episode begins with them, bool (N,).
        memory: The actor's, float32 (N, memory_size).
        returns: Sum of the rewards of each episode so far, float64 (N,).
        lengths: Timesteps of each episode so far, int64 (N,).
        scale: What rewards are divided by; None where they are learnt from as they are.
    """

    observations: Tensor
    starts: Tensor
    memory: Tensor
    returns: Tensor
    lengths: Tensor
    scale: RewardScale | None

    @classmethod
    def begin(cls, observations: Observations, spec: ActorCriticSpec, *, scale: RewardScale | None) -> "Standing":
        """Returns how episodes stand that begin with some observations.

        Raises:
            InvalidInput: They are not what the network sees.
        """
        count = len(observations)
        return cls(
            observations=checked_observations(observations, spec, count),
            starts=torch.ones(count, dtype=torch.bool),
            memory=torch.zeros(count, spec.memory_size),
            returns=torch.zeros(count, dtype=torch.float64),
            lengths=torch.zeros(count, dtype=torch.int64),
            scale=scale,
        )


@dataclass(frozen=True, eq=False)
class Rollout:
    """T timesteps of N environments; all on the CPU.

    Attributes:
        observations: uint8 (T, N, H, W, C) or float32 (T, N, D).
        starts: Whether an episode begins there, bool (T, N).
        actions: As they were drawn, float32 (T, N, A) or int64 (T, N, 1).
        log_probs: Of the actions when they were drawn, float32 (T, N).
        values: When they were drawn, float32 (T, N).
        rewards: As they are learnt from, float32 (T, N): scaled, and where an episode was cut off, with the discounted
            value of what it would have gone on from.
        ends: Whether an episode ended there, for whichever reason, bool (T, N).
        next_values: After the last timestep, float32 (N,).
        memory: Before the first timestep, float32 (N, memory_size).
        returns: Of the episodes that ended, their sums of unscaled rewards, float64 (episodes,).
        lengths: Of the same, their timesteps, int64 (episodes,).
    """

    observations: Tensor
    starts: Tensor
    actions: Tensor
    log_probs: Tensor
    values: Tensor
    rewards: Tensor
    ends: Tensor
    next_values: Tensor
    memory: Tensor
    returns: Tensor
    lengths: Tensor


@torch.no_grad()
def collect(
    network: ActorCritic,
    environments: Environments,
    standing: Standing,
    *,
    steps: int,
    discount: float,
    generator: torch.Generator,
) -> tuple[Rollout, Standing]:
    """Returns `steps` timesteps of every environment, and where they stand thereafter.

    Args:
        network: Acts; it is not changed.
        environments: Stand where `standing` says.
        standing: Where the last rollout ended.
        steps: T.
        discount: Of rewards, per timestep.
        generator: Draws the actions; on the CPU.

    Raises:
        InvalidInput: An environment answered what is no step, such as a reward that is not finite.
    """
    memory, taken = standing.memory, list[_Taken]()
    for _ in range(steps):
        step, standing = _take(network, environments, standing, discount=discount, generator=generator)
        taken.append(step)
    after = _outputs(network, standing.observations, standing.starts, standing.memory)
    rollout = Rollout(
        observations=torch.stack([step.observations for step in taken]),
        starts=torch.stack([step.starts for step in taken]),
        actions=torch.stack([step.actions for step in taken]),
        log_probs=torch.stack([step.log_probs for step in taken]),
        values=torch.stack([step.values for step in taken]),
        rewards=torch.stack([step.rewards for step in taken]),
        ends=torch.stack([step.ends for step in taken]),
        next_values=after.values[0].cpu(),
        memory=memory,
        returns=torch.cat([step.returns for step in taken]),
        lengths=torch.cat([step.lengths for step in taken]),
    )
    return rollout, standing


@dataclass(frozen=True, eq=False)
class _Taken:
    """One timestep of a rollout, fields as there."""

    observations: Tensor
    starts: Tensor
    actions: Tensor
    log_probs: Tensor
    values: Tensor
    rewards: Tensor
    ends: Tensor
    returns: Tensor
    lengths: Tensor


def _take(
    network: ActorCritic,
    environments: Environments,
    standing: Standing,
    *,
    discount: float,
    generator: torch.Generator,
) -> tuple[_Taken, Standing]:
    seen = _outputs(network, standing.observations, standing.starts, standing.memory)
    actions = seen.actions.sample(generator)
    step = environments.step(executable(actions[0]))
    observations, rewards = _checked(step, network.spec, len(standing.starts))
    ends = torch.from_numpy(step.terminated | step.truncated)
    returns, lengths = standing.returns + rewards, standing.lengths + 1
    scale = standing.scale
    if scale is not None:
        scale = scale.observe(rewards, discount=discount)
        rewards, scale = scale.apply(rewards), scale.end(ends)
    taken = _Taken(
        observations=standing.observations,
        starts=standing.starts,
        actions=actions[0].cpu(),
        log_probs=seen.actions.log_prob(actions)[0].cpu(),
        values=seen.values[0].cpu(),
        rewards=rewards + discount * _values_beyond(network, step, seen.memory.cpu()),
        ends=ends,
        returns=returns[ends],
        lengths=lengths[ends],
    )
    after = Standing(observations, ends, seen.memory.cpu(), returns * ~ends, lengths * ~ends, scale)
    return taken, after


def executable(actions: Tensor) -> Actions:
    """Returns actions (N, A) as environments take them: continuous ones within [-1, 1]."""
    array: Actions = (actions.clamp(-1, 1) if actions.is_floating_point() else actions).cpu().numpy()
    return array


def _values_beyond(network: ActorCritic, step: Step, memory: Tensor) -> Tensor:
    """Returns, where an episode was cut off, the value of what it would have gone on from, else 0: float32 (N,)."""
    values = torch.zeros(len(memory))
    was_cut = torch.from_numpy(step.truncated & ~step.terminated)
    if was_cut.any():
        last = checked_observations(step.final_observations, network.spec, len(memory))[was_cut]
        goes_on = torch.zeros(len(last), dtype=torch.bool)
        values[was_cut] = _outputs(network, last, goes_on, memory[was_cut]).values[0].cpu()
    return values


def _outputs(network: ActorCritic, observations: Tensor, starts: Tensor, memory: Tensor) -> Outputs:
    """Returns what a network, wherever it is, makes of one timestep of B environments, T = 1."""
    device = next(network.parameters()).device
    outputs: Outputs = network(observations[None].to(device), starts[None].to(device), memory.to(device))
    return outputs


def _checked(step: Step, spec: ActorCriticSpec, count: int) -> tuple[Tensor, Tensor]:
    """Returns the observations and rewards of a step that is one."""
    shapes = step.rewards.shape, step.terminated.shape, step.truncated.shape
    if set(shapes) != {(count,)} or not np.isfinite(step.rewards).all():
        raise InvalidInput(
            f"Environments must answer a finite reward and whether an episode ended, {count} times; "
            f"got shapes {', '.join(map(str, shapes))} and {np.isfinite(step.rewards).sum()} finite rewards.",
            hint="Look at the logs of the service that rewards come from.",
        )
    rewards = torch.from_numpy(np.array(step.rewards, np.float32))  # a copy: it may be read-only
    return checked_observations(step.observations, spec, count), rewards


def checked_observations(observations: Observations, spec: ActorCriticSpec, count: int) -> Tensor:
    """Returns a copy of the observations of `count` environments, on the CPU, that are what the network sees.

    Raises:
        InvalidInput: They are not.
    """
    dtype = np.dtype(np.float32 if spec.vector_size else np.uint8)
    shape = (count, *spec.observation_shape)
    if observations.dtype != dtype or observations.shape != shape:
        raise InvalidInput(
            f"Observations must be {dtype} {shape}; got {observations.dtype} {observations.shape}.",
            hint="Make the network for the frames that the environments render.",
        )
    if spec.vector_size and not np.isfinite(observations).all():
        raise InvalidInput("Observations must be finite; got some that are not.", hint="The simulation diverged.")
    return torch.from_numpy(observations.copy())
