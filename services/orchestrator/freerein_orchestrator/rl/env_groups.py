"""Groups of environments that step in turn: while one steps, the policy acts for another (Petrenko et al. 2020).

Groups share nothing but the network, which only reads: their rollouts are the same bits in whatever order they step.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import fields
from functools import partial
from typing import Generic, Protocol, TypeVar, cast

import numpy as np
import torch
from torch import Tensor

from freerein.learning.actor_critic.networks import ActorCritic
from freerein_orchestrator.rl.rollout import CollectorState, RolloutBuffer, collect
from freerein_orchestrator.rl.vec_env import Actions, Observations, Rewards, VecEnv, VecStep, given_up

_BY_ENV = frozenset({"last_observations", "last_values", "recurrent_state"})
"""Fields of a rollout whose first dimension is the environment; of the others it is the second."""


class ClosableVecEnv(VecEnv, Protocol):
    """Environments that hold what must be freed."""

    def close(self) -> None:
        """Frees it."""


E_co = TypeVar("E_co", bound=ClosableVecEnv, covariant=True)


class EnvGroups(Generic[E_co]):
    """Groups of environments as one `VecEnv`.

    Attributes:
        groups: In order of their environments.
    """

    def __init__(self, groups: Sequence[E_co]) -> None:
        self.groups = tuple(groups)
        self.num_envs = sum(group.num_envs for group in groups)
        self._cuts = np.cumsum([group.num_envs for group in groups])[:-1]

    def reset(self) -> Observations:
        """Starts an episode in every environment; returns the first observations."""
        return _joined([group.reset() for group in self.groups])

    def step(self, actions: Actions) -> VecStep:
        """Takes one action in every environment, group after group."""
        parts = cast(Sequence[Actions], np.split(actions, self._cuts))
        steps = [group.step(part) for group, part in zip(self.groups, parts, strict=True)]
        return VecStep(
            observations=_joined([step.observations for step in steps]),
            terminated=np.concatenate([step.terminated for step in steps]),
            truncated=np.concatenate([step.truncated for step in steps]),
            final_observations=_joined([step.final_observations for step in steps]),
            given_up=np.concatenate([given_up(step) for step in steps]),
        )

    def rewards(self) -> Rewards:
        """Returns the rewards of the T steps since the last call, float32 (T, N)."""
        return np.concatenate([group.rewards() for group in self.groups], axis=1)

    def snapshots(self) -> tuple[bytes, ...]:
        """Returns snapshots of the environments, group after group."""
        return tuple(snapshot for group in self.groups for snapshot in group.snapshots())

    def close(self) -> None:
        """Closes every group."""
        for group in self.groups:
            group.close()


def collect_groups(
    network: ActorCritic, envs: EnvGroups[ClosableVecEnv], state: CollectorState, *, num_steps: int
) -> tuple[RolloutBuffer, CollectorState]:
    """Returns a rollout and the state after it, as `collect`; each group is collected on a thread of its own.

    Each draws actions from a generator that is seeded by the state's.
    """
    generator = torch.Generator()
    generator.set_state(state.generator)
    parts = _split(state, [group.num_envs for group in envs.groups], generator)
    one = partial(collect, network, num_steps=num_steps)
    with ThreadPoolExecutor(len(parts), "group", partial(torch.set_flush_denormal, True)) as threads:
        futures = [threads.submit(one, group, part) for group, part in zip(envs.groups, parts, strict=True)]
        wait(futures)
    collected = [future.result() for future in futures]
    after = [part for _, part in collected]
    snapshots = tuple(snapshot for part in after for snapshot in part.env_snapshots)
    whole = CollectorState(
        observations=torch.cat([part.observations for part in after]),
        episode_starts=torch.cat([part.episode_starts for part in after]),
        recurrent_state=torch.cat([part.recurrent_state for part in after]),
        generator=generator.get_state(),
        env_snapshots=snapshots,
    )
    return _merge([rollout for rollout, _ in collected]), whole


def _split(state: CollectorState, sizes: Sequence[int], generator: torch.Generator) -> list[CollectorState]:
    """Returns the state of each group of so many environments; only the whole's snapshots say where they are."""
    states, first = [], 0
    for size in sizes:
        own, seed = slice(first, first + size), int(torch.randint(2**62, (), generator=generator))
        drawing = torch.Generator().manual_seed(seed).get_state()
        parts = (state.observations[own], state.episode_starts[own], state.recurrent_state[own])
        states.append(CollectorState(*parts, drawing, env_snapshots=()))
        first += size
    return states


def _merge(rollouts: Sequence[RolloutBuffer]) -> RolloutBuffer:
    """Returns the rollouts of groups as one of all environments."""
    merged = {"final_observations": _merged_finals(rollouts)}
    for name in {each.name for each in fields(RolloutBuffer)} - merged.keys():
        merged[name] = torch.cat([getattr(rollout, name) for rollout in rollouts], dim=0 if name in _BY_ENV else 1)
    return RolloutBuffer(**merged)


def _merged_finals(rollouts: Sequence[RolloutBuffer]) -> Tensor:
    """Returns the final observations of all groups, by time and environment."""
    first, times, envs = 0, [], []
    for rollout in rollouts:
        time, env = rollout.dones.nonzero().unbind(dim=1)
        times.append(time)
        envs.append(env + first)
        first += rollout.dones.shape[1]
    order = (torch.cat(times) * first + torch.cat(envs)).argsort()
    return torch.cat([rollout.final_observations for rollout in rollouts])[order]


def _joined(observations: Sequence[Observations]) -> Observations:
    return cast(Observations, np.concatenate(observations))
