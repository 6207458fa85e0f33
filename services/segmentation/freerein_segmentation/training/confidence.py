"""Whether a network decides between the tags of a trajectory, measured without true labels."""

from dataclasses import dataclass

import torch
from torch import Tensor

CONFIDENCE = "confidence"
"""Name of the tensor that a fit carries from the start of its final objective on: the network's confidence then."""

_LEAST_DECIDED = 1 / 3
"""Share of the way from equal shares to certainty below which labels are undecided."""


@dataclass(frozen=True)
class Confidence:
    """The confidence of a network on held-out timesteps of trajectories with two or more tags: the highest probability.

    Attributes:
        mean: Its mean; 1, as is `equal`, where no trajectory has two tags.
        equal: Its value if all tags of a trajectory had equal shares at every timestep. A loss that wants equal
            shares over time is at its optimum then, and labels say nothing.
    """

    mean: float
    equal: float

    @classmethod
    def over(cls, highest: Tensor, tags: Tensor) -> "Confidence":
        """Returns that of timesteps, of their highest probability and their trajectory's number of tags, both (N,)."""
        is_open = tags > 1
        if not is_open.any():
            return cls(1.0, 1.0)
        return cls(highest[is_open].mean().item(), (1 / tags[is_open]).mean().item())

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
    def has_choice(self) -> bool:
        """Whether some trajectory has two tags to decide between."""
        return self.equal < 1

    @property
    def is_decided(self) -> bool:
        """Whether labels favour one of the tags, or no trajectory has two."""
        return self.mean - self.equal >= _LEAST_DECIDED * (1 - self.equal)
