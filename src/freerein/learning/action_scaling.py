"""Continuous actions in a robot's own unit, scaled to about [-1, 1] by what a model was trained on."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from torch import Tensor

from freerein.types.common import ActionSpec

_QUANTILES = (0.01, 0.99)
_FARTHEST = 10.0
"""Scaled values beyond which a network sees no difference: a broken sensor must not drown the rest."""

_LEAST_MARGIN = 2.0**-22
"""Around a constant, relative to it: at least two steps of float32."""
_MOST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class ActionScaling:
    """A linear map of each number of an action; a model's card keeps it: scaled = 2 (a - low) / (high - low) - 1.

    Attributes:
        low: Value that is scaled to -1: the 1 % quantile.
        high: Value that is scaled to 1: the 99 % quantile; greater than `low`.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def of(cls, actions: npt.NDArray[np.float32]) -> "ActionScaling":
        """Returns the scaling of finite actions (N, A).

        A number whose quantiles are equal is scaled by its extremes, and a constant becomes 0.
        """
        low, high = np.quantile(actions.astype(np.float64), _QUANTILES, axis=0)  # (A,) each
        differ = low.astype(np.float32) < high.astype(np.float32)  # as `scaled` sees them
        least, greatest = np.where(differ, (low, high), (actions.min(axis=0), actions.max(axis=0)))
        margin = np.where(least < greatest, 0, np.maximum(1, np.abs(least) * _LEAST_MARGIN))
        bounds = np.clip((least - margin, greatest + margin), -_MOST, _MOST)
        return cls(*(tuple(each) for each in bounds.tolist()))

    def scaled(self, actions: Tensor) -> Tensor:
        """Returns actions, float (..., A), scaled for a network."""
        low, high = actions.new_tensor(self.low), actions.new_tensor(self.high)
        return (2 * (actions - low) / (high - low) - 1).clamp(-_FARTHEST, _FARTHEST)


class UnscaledActionSpec(ActionSpec):
    """An action space in the robot's own unit, whose numbers may be any."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest finite value."""
        return -_MOST, _MOST
