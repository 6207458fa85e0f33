"""What the rewards of episodes add up to."""

from dataclasses import dataclass

import torch
from torch import Tensor

from freerein_orchestrator.reward_scale import RewardScale


@dataclass(frozen=True, eq=False)
class Earnings:
    """What T timesteps of N environments earned.

    Attributes:
        rewards: As they are learnt from, float32 (T, N).
        returns: Of the episodes that ended, their sums of unscaled rewards, float64 (episodes,).
        lengths: Of the same, their timesteps, int64 (episodes,).
    """

    rewards: Tensor
    returns: Tensor
    lengths: Tensor


@dataclass(frozen=True, eq=False)
class Tally:
    """What the present episode of each environment has come to so far.

    Attributes:
        returns: Sum of its rewards, float64 (N,).
        lengths: Its timesteps, int64 (N,).
        scale: What rewards are divided by; None where they are learnt from as they are.
    """

    returns: Tensor
    lengths: Tensor
    scale: RewardScale | None

    @classmethod
    def begin(cls, num_envs: int, *, scale: RewardScale | None) -> "Tally":
        """Returns the tally before the first reward."""
        return cls(torch.zeros(num_envs, dtype=torch.float64), torch.zeros(num_envs, dtype=torch.int64), scale)

    def add(self, rewards: Tensor, ends: Tensor, *, discount: float) -> tuple[Earnings, "Tally"]:
        """Returns what rewards amount to, and the tally thereafter.

        Args:
            rewards: float32 (T, N).
            ends: Whether an episode ended with them, bool (T, N).
            discount: Of rewards, per timestep.
        """
        tally, learnt, returns, lengths = self, [], [], []
        for earned, ended in zip(rewards, ends, strict=True):
            after, scaled = tally._after(earned, discount=discount)
            learnt.append(scaled)
            returns.append(after.returns[ended])
            lengths.append(after.lengths[ended])
            tally = after._without(ended)
        return Earnings(torch.stack(learnt), torch.cat(returns), torch.cat(lengths)), tally

    def _after(self, rewards: Tensor, *, discount: float) -> tuple["Tally", Tensor]:
        """Returns the tally after one timestep's rewards, and these scaled: float32 (N,)."""
        scale = None if self.scale is None else self.scale.observe(rewards, discount=discount)
        scaled = rewards if scale is None else scale.apply(rewards)
        return Tally(self.returns + rewards, self.lengths + 1, scale), scaled

    def _without(self, ended: Tensor) -> "Tally":
        """Returns the tally where the episodes in `ended`, bool (N,), are over."""
        scale = None if self.scale is None else self.scale.end(ended)
        return Tally(self.returns * ~ended, self.lengths * ~ended, scale)
