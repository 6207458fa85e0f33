"""Rewards of any size, brought to about one, so that one learning rate and one weight of the value loss fit all."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

_LARGEST = 10.0
_NOTHING = 1e-8


@dataclass(frozen=True, eq=False)
class RewardScale:
    """The running spread of the discounted sums of rewards. Rewards are divided by it, and never shifted.

    Attributes:
        sums: Discounted sum of the rewards of each environment's episode so far, float64 (N,).
        moments: How many sums were seen, their mean, and their summed squared deviations from it, float64 (3,).
    """

    sums: Tensor
    moments: Tensor

    @classmethod
    def begin(cls, num_envs: int) -> "RewardScale":
        """Returns the scale before the first reward."""
        return cls(torch.zeros(num_envs, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))

    def observe(self, rewards: Tensor, *, discount: float) -> "RewardScale":
        """Returns the scale after one timestep's rewards, float32 (N,)."""
        sums = discount * self.sums + rewards
        return RewardScale(sums, _merge(self.moments, sums))

    def end(self, ends: Tensor) -> "RewardScale":
        """Returns the scale where the episodes in `ends`, bool (N,), are over."""
        return replace(self, sums=torch.where(ends, 0.0, self.sums))

    def apply(self, rewards: Tensor) -> Tensor:
        """Returns rewards, float32 (N,), over the standard deviation of their sums, within ±10."""
        count, _, squares = self.moments
        std = (squares / count.clamp(min=1.0) + _NOTHING).sqrt()
        scaled: Tensor = (rewards / std).clamp(-_LARGEST, _LARGEST).float()
        return scaled


def _merge(moments: Tensor, batch: Tensor) -> Tensor:
    """Returns count, mean and summed squares of what was seen and a batch together (Chan et al. 1979)."""
    count, mean, squares = moments
    total, shift = count + len(batch), batch.mean() - mean
    spread = (batch - batch.mean()).square().sum() + shift.square() * count * len(batch) / total
    return torch.stack([total, mean + shift * len(batch) / total, squares + spread])
