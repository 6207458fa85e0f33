"""Measures: numbers that a task can compute from true states, for evaluation."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.types.sim import Measure

Values = npt.NDArray[np.float64]
"""float64 (N, T)."""


@dataclass(frozen=True, eq=False)
class StateMeasure:
    """A number of true states.

    Attributes:
        name: Its name within the task, other than those of its predicates.
        values: Returns the number at each timestep, as float64 (N, T). The arguments are the states, float64 (N, T, S),
            and, only if `needs_reference`, references of the same shape.
        unit: Its physical unit; empty where it has none.
        needs_reference: Whether it compares each state with a reference.
    """

    name: str
    values: Callable[..., Values]
    unit: str = ""
    needs_reference: bool = False

    def describe(self) -> Measure:
        """Returns the measure as the API describes it."""
        return Measure(self.name, self.unit, self.needs_reference)
