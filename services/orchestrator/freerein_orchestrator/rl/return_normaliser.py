"""Reward scaling by the running standard deviation of the discounted return, as in Engstrom et al. (2020)."""

from dataclasses import dataclass

import torch
from torch import Tensor

_CLIP = 10.0
_EPSILON = 1e-8


@dataclass(frozen=True, eq=False)
class ReturnNormaliser:
    """Running statistics of the discounted return; rewards are divided by its standard deviation, never shifted.

    Attributes:
        returns: Discounted return so far of each environment's episode, float64 (N,).
        moments: Count, mean and sum of squared deviations of all returns, float64 (3,).
    """

    returns: Tensor
    moments: Tensor

    @classmethod
    def init(cls, num_envs: int) -> "ReturnNormaliser":
        """Returns the statistics before the first reward."""
        return cls(torch.zeros(num_envs, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))

    def normalise(self, rewards: Tensor, dones: Tensor, *, gamma: float) -> tuple[Tensor, "ReturnNormaliser"]:
        """Returns scaled rewards, float32 (T, N) in [-10, 10], and the statistics after them.

        Args:
            rewards: float32 (T, N).
            dones: Whether an episode ended, bool (T, N).
            gamma: Discount factor.
        """
        returns, moments, scaled = self.returns, self.moments, []
        for reward, done in zip(rewards, dones, strict=True):
            returns = gamma * returns + reward
            moments = _merge(moments, returns)
            std = (moments[2] / moments[0] + _EPSILON).sqrt()
            scaled.append((reward / std).clamp(-_CLIP, _CLIP).float())
            returns = torch.where(done, 0.0, returns)
        return torch.stack(scaled), ReturnNormaliser(returns, moments)


def _merge(moments: Tensor, batch: Tensor) -> Tensor:
    """Returns count, mean and squared deviations of both samples together (Chan et al. 1979)."""
    count, mean, squares = moments
    total, shift = count + len(batch), batch.mean() - mean
    spread = (batch - batch.mean()).square().sum() + shift.square() * count * len(batch) / total
    return torch.stack([total, mean + shift * len(batch) / total, squares + spread])
