"""How experience is collected from environments, wherever these are.

Actions are drawn from a generator of their own, and the next one is drawn before the last one's reward is known:
experience is the same bits whether or not the learner is at work on what was collected before, and however long
rewards take.
"""

from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein_orchestrator.networks import ActorCritic, ActorCriticSpec, Outputs
from freerein_orchestrator.rejection import Rejected
from freerein_orchestrator.tally import Tally

Observations: TypeAlias = npt.NDArray[np.uint8] | npt.NDArray[np.float32]
"""Of N environments: frames uint8 (N, H, W, C), or vectors float32 (N, D)."""
Actions: TypeAlias = npt.NDArray[np.float32] | npt.NDArray[np.int64]
"""Of N environments: float32 (N, A) in [-1, 1], or choices int64 (N, 1)."""
Rewards: TypeAlias = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Step:
    """What one step of N environments came to. Where it ended an episode, the next one has begun.

    Attributes:
        observations: Of the next timestep; where an episode ended, the first of the next one.
        terminated: bool (N,), whether the episode came to its end: nothing is worth anything thereafter.
        truncated: bool (N,), whether it was cut off, by a limit of time: it would have gone on.
        final_observations: As `observations`, but where an episode ended its own last one; the others are not read.
    """

    observations: Observations
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

    def rewards(self) -> Rewards:
        """Returns the rewards of the T steps since they were last asked for, float32 (T, N); waits for them."""

    def snapshots(self) -> tuple[bytes, ...]:
        """Returns how to bring the environments back to where they stand; none where that cannot be."""


@dataclass(frozen=True, eq=False)
class Standing:
    """Where the environments' episodes stand between two timesteps, as far as the actor knows; all on the CPU.

    Attributes:
        observations: The present ones, uint8 (N, H, W, C) or float32 (N, D).
        starts: Whether an episode begins with them, bool (N,).
        memory: The actor's, float32 (N, memory_size).
        tally: What the episodes have come to.
    """

    observations: Tensor
    starts: Tensor
    memory: Tensor
    tally: Tally

    @classmethod
    def begin(cls, observations: Observations, spec: ActorCriticSpec, tally: Tally) -> "Standing":
        """Returns how episodes stand that begin with some observations.

        Raises:
            InvalidInput: They are not what the network sees.
        """
        count = len(observations)
        return cls(
            observations=checked_observations(observations, spec, count),
            starts=torch.ones(count, dtype=torch.bool),
            memory=torch.zeros(count, spec.memory_size),
            tally=tally,
        )


@dataclass(frozen=True, eq=False)
class Rollout:
    """T timesteps of N environments; all on the CPU.

    Attributes:
        observations: uint8 (T, N, H, W, C) or float32 (T, N, D).
        starts: Whether an episode begins there, bool (T, N).
        actions: As they were drawn, float32 (T, N, A) or int64 (T, N, 1).
        log_probs: Of the actions when they were drawn, float32 (T, N).
        rewards: As they are learnt from, float32 (T, N).
        ends: Whether an episode ended there, for whichever reason, bool (T, N).
        cuts: Whether one was cut off there, and would have gone on, bool (T, N).
        cut_observations: What the K episodes that were cut off would have gone on from, by time and environment,
            uint8 (K, H, W, C) or float32 (K, D).
        next_observations: After the last timestep, uint8 (N, H, W, C) or float32 (N, D).
        memory: The actor's, before the first timestep, float32 (N, memory_size).
        returns: Of the episodes that ended, their sums of unscaled rewards, float64 (episodes,).
        lengths: Of the same, their timesteps, int64 (episodes,).
    """

    observations: Tensor
    starts: Tensor
    actions: Tensor
    log_probs: Tensor
    rewards: Tensor
    ends: Tensor
    cuts: Tensor
    cut_observations: Tensor
    next_observations: Tensor
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
        environments: Stand where `standing` says; no rewards are left that were not asked for.
        standing: Where the last rollout ended.
        steps: T.
        discount: Of rewards, per timestep.
        generator: Draws the actions; on the CPU.

    Raises:
        Rejected: An environment answered what is no step, or a reward is not finite.
    """
    seen, taken = _Seen(standing.observations, standing.starts, standing.memory), list[_Taken]()
    for _ in range(steps):
        step, seen = _take(network, environments, seen, generator=generator)
        taken.append(step)
    ends = torch.stack([step.ends for step in taken])
    rewards = _checked_rewards(environments.rewards(), ends.shape)
    earnings, tally = standing.tally.add(rewards, ends, discount=discount)
    rollout = Rollout(
        observations=torch.stack([step.observations for step in taken]),
        starts=torch.stack([step.starts for step in taken]),
        actions=torch.stack([step.actions for step in taken]),
        log_probs=torch.stack([step.log_probs for step in taken]),
        rewards=earnings.rewards,
        ends=ends,
        cuts=torch.stack([step.cuts for step in taken]),
        cut_observations=torch.cat([step.cut_observations for step in taken]),
        next_observations=seen.observations,
        memory=standing.memory,
        returns=earnings.returns,
        lengths=earnings.lengths,
    )
    return rollout, Standing(seen.observations, seen.starts, seen.memory, tally)


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the actor acts on, fields as of `Standing`."""

    observations: Tensor
    starts: Tensor
    memory: Tensor


@dataclass(frozen=True, eq=False)
class _Taken:
    """One timestep of a rollout, fields as there."""

    observations: Tensor
    starts: Tensor
    actions: Tensor
    log_probs: Tensor
    ends: Tensor
    cuts: Tensor
    cut_observations: Tensor


def _take(
    network: ActorCritic, environments: Environments, seen: _Seen, *, generator: torch.Generator
) -> tuple[_Taken, _Seen]:
    device = next(network.parameters()).device
    shown = (seen.observations[None], seen.starts[None], seen.memory)  # one timestep
    outputs: Outputs = network(*(each.to(device) for each in shown))
    actions, memory = outputs.actions.sample(generator), outputs.memory.cpu()
    step = environments.step(executable(actions[0]))
    observations = _checked_step(step, network.spec, len(seen.starts))
    ends, cuts = torch.from_numpy(step.terminated | step.truncated), torch.from_numpy(step.truncated & ~step.terminated)
    last = _observed(step.final_observations, network.spec, len(cuts))[cuts] if cuts.any() else observations[:0]
    taken = _Taken(
        observations=seen.observations,
        starts=seen.starts,
        actions=actions[0].cpu(),
        log_probs=outputs.actions.log_prob(actions)[0].cpu(),
        ends=ends,
        cuts=cuts,
        cut_observations=last,
    )
    return taken, _Seen(observations, ends, memory)


def executable(actions: Tensor) -> Actions:
    """Returns actions (N, A) as environments take them: continuous ones within [-1, 1]."""
    array: Actions = (actions.clamp(-1, 1) if actions.is_floating_point() else actions).cpu().numpy()
    return array


def _checked_step(step: Step, spec: ActorCriticSpec, count: int) -> Tensor:
    """Returns the observations of a step that is one."""
    if {step.terminated.shape, step.truncated.shape} != {(count,)}:
        raise Rejected(
            f"Environments must answer {count} times whether an episode ended; "
            f"got shapes {step.terminated.shape} and {step.truncated.shape}.",
            hint="Look at the log of the sim service.",
        )
    return _observed(step.observations, spec, count)


def _observed(observations: Observations, spec: ActorCriticSpec, count: int) -> Tensor:
    """Returns observations as `checked_observations`, but what is wrong with them is no fault of the caller's."""
    try:
        return checked_observations(observations, spec, count)
    except InvalidInput as error:
        raise Rejected(error.detail, hint="Look at the log of the sim service.") from error


def _checked_rewards(rewards: Rewards, shape: torch.Size) -> Tensor:
    """Returns a copy of rewards that are finite and one for each step."""
    if rewards.shape != shape or not np.isfinite(rewards).all():
        raise Rejected(
            f"Rewards must be finite and of shape {tuple(shape)}; "
            f"got shape {rewards.shape} with {np.isfinite(rewards).sum()} finite ones.",
            hint="Look at the log of the service that rewards come from.",
        )
    return torch.from_numpy(np.array(rewards, np.float32))


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
