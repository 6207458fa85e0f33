"""Whether a network decides between the tags of a trajectory, told without true labels."""

from dataclasses import dataclass

import torch
from torch import Tensor

_LEAST_DECIDED = 1 / 3
"""Share of the way from equal shares to certainty below which labels are undecided."""


@dataclass(frozen=True)
class Confidence:
    """The confidence of a network on held-out timesteps: their highest probability.

    Attributes:
        mean: Its mean.
        equal: What it were if all tags of a trajectory had equal shares at every timestep. A loss that wants equal
            shares over time is at its optimum then, and labels say nothing.
    """

    mean: float
    equal: float

    @classmethod
    def of(cls, tensor: Tensor) -> "Confidence":
        """Returns what `tensor` holds."""
        mean, equal = tensor.tolist()
        return cls(mean, equal)

    @property
    def tensor(self) -> Tensor:
        """Both, float64 (2,)."""
        return torch.tensor([self.mean, self.equal], dtype=torch.float64)

    @property
    def is_decided(self) -> bool:
        """Whether labels favour one of the tags; where trajectories have a single one, there is nothing to decide."""
        return self.mean - self.equal >= _LEAST_DECIDED * (1 - self.equal)
