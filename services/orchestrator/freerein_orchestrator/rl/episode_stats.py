"""Returns and lengths of episodes, across rollouts."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class EpisodeStats:
    """Return and length so far of each environment's present episode.

    Attributes:
        returns: Sum of rewards, float64 (N,).
        lengths: Timesteps, int64 (N,).
    """

    returns: Tensor
    lengths: Tensor

    @classmethod
    def init(cls, num_envs: int) -> "EpisodeStats":
        """Returns the statistics before the first reward."""
        return cls(torch.zeros(num_envs, dtype=torch.float64), torch.zeros(num_envs, dtype=torch.int64))

    def update(self, rewards: Tensor, dones: Tensor) -> tuple["EpisodeStats", "EpisodeStats"]:
        """Returns the statistics after a rollout, and those of the episodes that ended in it.

        Args:
            rewards: float32 (T, N).
            dones: Whether an episode ended, bool (T, N).
        """
        returns, lengths = self.returns, self.lengths
        ended: list[tuple[Tensor, Tensor]] = []
        for reward, done in zip(rewards, dones, strict=True):
            returns, lengths = returns + reward, lengths + 1
            ended.append((returns[done], lengths[done]))
            returns, lengths = returns * ~done, lengths * ~done
        return EpisodeStats(returns, lengths), EpisodeStats(*map(torch.cat, zip(*ended, strict=True)))

    def metrics(self) -> dict[str, float]:
        """Returns the mean return and length; empty when there are no episodes."""
        if not len(self.returns):
            return {}
        return {
            "episode_return": self.returns.mean().item(),
            "episode_length": self.lengths.double().mean().item(),
        }
