"""Practice: training episodes that begin where earlier ones were on their way to a reward.

States that the policy visits are kept now and then. Those from which an episode that was not rewarded yet went on to
be are starts: at the end of a rollout some environments are set to one, drawn evenly, and begin the next rollout there.
A hard task is learned from its end backwards, as in Florensa et al. 2017 ("Reverse curriculum generation for
reinforcement learning"), and nothing is known of it but the reward: the simulator arranges no state, it returns to one.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, compress, pairwise
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from freerein_orchestrator.rl.env_groups import ClosableVecEnv
from freerein_orchestrator.rl.vec_env import Actions, Observations, Rewards, VecStep

STEPS_BETWEEN = 8
"""Steps between the states of one environment that may become starts."""

MOST_STARTS = 512
"""The newest are kept."""

_HEADER_BYTES = 8


@dataclass(frozen=True)
class Start:
    """The state of one environment of a snapshot."""

    snapshot: bytes
    env: int


class RestorableEnvs(ClosableVecEnv, Protocol):
    """Environments that can be set to states one by one."""

    def states(self) -> Sequence[Start]:
        """Returns the present state of each environment."""

    def begin_at(self, starts: Mapping[int, Start]) -> Observations:
        """Sets the environments that are named to states of earlier ones; returns the observations of all (N, ...)."""


class PractisingEnvs:
    """Environments some of which practise, as `VecEnv`; an episode that is given up for a start is truncated.

    Args:
        envs: The environments.
        share: Probability with which an environment begins a rollout at a start, once there are any.
        num_steps: Steps of a rollout.
        memory: The last of `snapshots`; None to begin without starts.
        seed: Seeds the draws where there is no memory.
    """

    def __init__(
        self, envs: RestorableEnvs, *, share: float, num_steps: int, memory: bytes | None = None, seed: Sequence[int]
    ) -> None:
        self.num_envs = envs.num_envs
        self._envs = envs
        self._share = share
        self._num_steps = num_steps
        self._rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
        self._starts: list[Start] = []
        if memory is not None:
            self._remember(memory)
        self._passed: list[Sequence[Start]] = []
        self._dones: list[npt.NDArray[np.bool_]] = []

    def reset(self) -> Observations:
        """Starts an episode of the task's own in every environment; returns the first observations."""
        return self._envs.reset()

    def step(self, actions: Actions) -> VecStep:
        """Takes one action in every environment; after the last of a rollout, some are set to starts."""
        step = self._envs.step(actions)
        if len(self._dones) % STEPS_BETWEEN == 0:  # after the step: its reward is of the state that it led to
            self._passed.append(self._envs.states())
        self._dones.append(step.terminated | step.truncated)
        return self._with_starts(step) if len(self._dones) == self._num_steps and self._starts else step

    def rewards(self) -> Rewards:
        """Returns the rewards of the T steps since the last call, float32 (T, N); finds the starts among them."""
        rewards = self._envs.rewards()
        on_the_way = before_reward(rewards > 0, np.array(self._dones))[::STEPS_BETWEEN]
        found = chain.from_iterable(map(compress, self._passed, on_the_way))
        self._starts = [*self._starts, *found][-MOST_STARTS:]
        self._passed, self._dones = [], []
        return rewards

    def snapshots(self) -> tuple[bytes, ...]:
        """Returns snapshots of the environments, and last the starts and the state of the generator."""
        return (*self._envs.snapshots(), self._memory())

    def close(self) -> None:
        """Closes the environments."""
        self._envs.close()

    def _with_starts(self, step: VecStep) -> VecStep:
        practise = self._rng.random(self.num_envs) < self._share
        if not practise.any():
            return step
        drawn = self._rng.integers(len(self._starts), size=self.num_envs)
        frames = self._envs.begin_at({int(env): self._starts[drawn[env]] for env in np.flatnonzero(practise)})
        ended = step.terminated | step.truncated
        given_up = practise & ~ended
        shown = (...,) + (None,) * (step.observations.ndim - 1)
        return VecStep(
            observations=np.where(practise[shown], frames, step.observations),
            terminated=step.terminated,
            truncated=step.truncated | given_up,
            final_observations=np.where(ended[shown], step.final_observations, step.observations),
            given_up=given_up,
        )

    def _memory(self) -> bytes:
        """Returns header length (8) | header, JSON | each distinct snapshot."""
        places = {snapshot: place for place, snapshot in enumerate(dict.fromkeys(s.snapshot for s in self._starts))}
        header = {
            "generator": self._rng.bit_generator.state,
            "lengths": [len(snapshot) for snapshot in places],
            "starts": [(places[start.snapshot], start.env) for start in self._starts],
        }
        encoded = json.dumps(header).encode()
        return b"".join((len(encoded).to_bytes(_HEADER_BYTES), encoded, *places))

    def _remember(self, memory: bytes) -> None:
        end = _HEADER_BYTES + int.from_bytes(memory[:_HEADER_BYTES])
        header: dict[str, Any] = json.loads(memory[_HEADER_BYTES:end])
        ends = end + np.cumsum([0, *header["lengths"]])
        snapshots = [memory[first:last] for first, last in pairwise(ends.tolist())]
        self._rng.bit_generator.state = header["generator"]
        self._starts = [Start(snapshots[place], env) for place, env in header["starts"]]


def before_reward(rewarded: npt.NDArray[np.bool_], dones: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Returns whether a step is not rewarded, but a later one of its episode is, bool (T, N).

    Args:
        rewarded: Whether the state that each step leads to is rewarded, bool (T, N).
        dones: Whether an episode ends with the step, bool (T, N).
    """
    will_be, before = np.zeros(rewarded.shape[1], np.bool_), np.zeros_like(rewarded)
    for step in reversed(range(len(rewarded))):
        before[step] = will_be & ~dones[step] & ~rewarded[step]
        will_be = rewarded[step] | will_be & ~dones[step]
    return before
