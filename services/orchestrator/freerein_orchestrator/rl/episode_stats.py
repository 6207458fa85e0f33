"""Returns and lengths of episodes, across rollouts."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class EpisodeStats:
    """Return and length so far of each environment's present episode.

    Attributes:
        returns: Sum of rewards, float64 (N,).
        lengths: Actions, int64 (N,).
    """

    returns: Tensor
    lengths: Tensor

    @classmethod
    def init(cls, num_envs: int) -> "EpisodeStats":
        """Returns the statistics before the first reward."""
        return cls(torch.zeros(num_envs, dtype=torch.float64), torch.zeros(num_envs, dtype=torch.int64))

    def update(self, rewards: Tensor, dones: Tensor, given_up: Tensor) -> tuple["EpisodeStats", "EpisodeStats"]:
        """Returns the statistics after a rollout, and those of the episodes that ended in it.

        Args:
            rewards: float32 (T, N).
            dones: Whether an episode ended, bool (T, N).
            given_up: Whether it was given up for another state, bool (T, N): its return is not that of an episode.
        """
        returns, lengths = self.returns, self.lengths
        ended: list[tuple[Tensor, Tensor]] = []
        for reward, done, unfinished in zip(rewards, dones, given_up, strict=True):
            returns, lengths = returns + reward, lengths + 1
            counted = done & ~unfinished
            ended.append((returns[counted], lengths[counted]))
            returns, lengths = returns * ~done, lengths * ~done
        return EpisodeStats(returns, lengths), EpisodeStats(*map(torch.cat, zip(*ended, strict=True)))

    def metrics(self, *, action_repeat: int = 1) -> dict[str, float]:
        """Returns the mean return, and the mean length in timesteps; empty when there are no episodes.

        Args:
            action_repeat: Timesteps per action; a last one that the episode's end cut short counts in full.
        """
        if not len(self.returns):
            return {}
        return {
            "episode_return": self.returns.mean().item(),
            "episode_length": action_repeat * self.lengths.double().mean().item(),
        }
