"""What a policy answers."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, eq=False)
class Step:
    """What a policy makes of B observations.

    Attributes:
        actions: What to do next, float32 (B, K, A) in [-1, 1], or int64 (B, K, 1) where actions are discrete.
        reached: The probability that each observation is at its goal, float32 (B,).
        memory: The recurrent memory after this step, float32 (B, M).
    """

    actions: npt.NDArray[Any]
    reached: npt.NDArray[np.float32]
    memory: npt.NDArray[np.float32]
