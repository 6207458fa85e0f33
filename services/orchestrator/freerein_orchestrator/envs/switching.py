"""Switching between goal images that is not the policy's own, for evaluation only.

The policy is given the next goal as soon as it has used up its steps or, a ceiling, truly is at the present one. Its
own flag ends no goal: each goal is given twice, and where the policy goes on to the second, it begins anew with both.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
import numpy.typing as npt

from freerein.types.common import Goal
from freerein_orchestrator.envs.policies import PolicyHandle, PolicyOutput, PolicySession, ServedPolicy
from freerein_orchestrator.rl.vec_env import Actions, Frames

States = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
IsAt = Callable[[States, Indices], npt.NDArray[np.bool_]]


class Switching:
    """Which goal each of N environments pursues.

    Args:
        goals: The goals of each environment, in order, each of one moment.
        is_at: Returns which environments are at a goal, bool (N,), given their true states, float64 (N, S), and the
            goal of each, int64 (N,); None where steps alone count.
        max_steps: Actions after which a goal is abandoned.

    Attributes:
        index: int64 (N,), goals that are over, reached or abandoned.
    """

    def __init__(self, goals: Sequence[Sequence[Goal]], is_at: IsAt | None, *, max_steps: int) -> None:
        self.index: Indices = np.zeros(len(goals), np.int64)
        self._steps: Indices = np.zeros(len(goals), np.int64)  # actions for the present goal, if it goes on
        self._max_steps = max_steps
        self._goals = goals
        self._last = np.array([len(each) - 1 for each in goals], np.int64)
        self._is_at = is_at

    @property
    def is_over(self) -> npt.NDArray[np.bool_]:
        """Whether all goals of each environment are over, bool (N,)."""
        return self.index > self._last

    @property
    def goals(self) -> list[Goal]:
        """The goal of each environment, twice; its last one where all are over."""
        present = np.minimum(self.index, self._last).tolist()
        return [Goal(each[index].images * 2) for each, index in zip(self._goals, present, strict=True)]

    def tell(self, states: States) -> None:
        """Takes the environments' true states before an action, float64 (N, S), and goes on where a goal is over."""
        is_over = self._steps >= self._max_steps
        if self._is_at is not None:
            is_over |= self._is_at(states, np.minimum(self.index, self._last))
        self.index = self.index + (is_over & (self.index <= self._last))
        self._steps = np.where(is_over, 0, self._steps) + 1

    def switch(self, policy: PolicyHandle) -> PolicyHandle:
        """Returns a policy with goals, switched: to be run once, while `tell` gets the states before each action."""

        def start(session: PolicySession) -> "_SwitchedPolicy":
            return _SwitchedPolicy(self, cast(ServedPolicy, policy.start(replace(session, goals=self.goals))))

        return replace(policy, start=start)


class _SwitchedPolicy:
    """Acts for the goal that the switching says, and holds once all are over."""

    def __init__(self, switching: Switching, served: ServedPolicy) -> None:
        self._switching = switching
        self._served = served
        self._given = switching.index

    def act(self, frames: Mapping[str, Frames], episode_starts: npt.NDArray[np.bool_]) -> PolicyOutput:
        goals = self._switching.goals
        for env in np.flatnonzero(self._given != self._switching.index).tolist():
            self._served.begin(env, goals[env])
        self._given = self._switching.index
        output = self._served.act(frames, episode_starts)
        for env, ended in enumerate(() if output.goal_index is None else output.goal_index):
            if ended:
                self._served.begin(env, goals[env])
        over = self._switching.is_over
        actions = np.where(over[:, None], self._served.hold, output.actions).astype(output.actions.dtype)
        return PolicyOutput(cast(Actions, actions), self._switching.index, output.goal_confidence)
