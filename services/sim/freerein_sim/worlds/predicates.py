"""Predicates: what a task can judge from true states, for evaluation.

The names that several worlds share have one meaning in all of them:

- `at-landmark` (with references): robot and objects are where the reference has them.
- `object-moves` (with references): some object is not where the reference has it.
- `lifted/SKILL`: the object of the skill has risen since the first state.
- `completed/SKILL`: the skill was executed since the first state.
- `start/WHAT`: how the sequence began; figures are split by it. `start/in-order` means that the goal needs no change of
  order, only a push.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.types.sim import Predicate

AT_LANDMARK, OBJECT_MOVES, START = "at-landmark", "object-moves", "start/"

States = npt.NDArray[np.float64]
"""float64 (N, T, S): true states of N sequences of T timesteps, named by the spec's `state_names`."""

Flags = npt.NDArray[np.bool_]
"""bool (N, T)."""


@dataclass(frozen=True, eq=False)
class StatePredicate:
    """A statement about true states.

    Attributes:
        name: Its name within the task.
        holds: Returns whether it holds at each timestep, given the sequence up to there, as bool (N, T). The arguments
            are the states and, only if `needs_reference`, references of the same shape.
        text: What it states, as a caption; empty where no image could show it.
        group: Predicates of one group exclude each other; empty for no group.
        needs_reference: Whether it compares each state with a reference.
    """

    name: str
    holds: Callable[..., Flags]
    text: str = ""
    group: str = ""
    needs_reference: bool = False

    def describe(self) -> Predicate:
        """Returns the predicate as the API describes it."""
        return Predicate(self.name, self.text, self.group, self.needs_reference)
