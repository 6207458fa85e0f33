"""Elliptical episodic bonus (E3B, Henaff et al. 2022): how new what is seen is within its episode.

Of features phi of what an episode has shown so far, C = ridge * I + sum phi phi^T; the bonus of the next one is
phi^T C^-1 phi. Turning on the spot is new for one turn, and no longer.
"""

import torch
from torch import Tensor


def first_inverse(features: int, *, ridge: float) -> Tensor:
    """Returns C^-1 before anything was seen, float64 (features, features)."""
    return torch.eye(features, dtype=torch.float64) / ridge


def episodic_bonuses(
    before: Tensor, after: Tensor, starts: Tensor, inverses: Tensor, *, ridge: float
) -> tuple[Tensor, Tensor]:
    """Returns the bonuses of T timesteps of N environments, float64 (T, N), and C^-1 after them, float64 (N, D, D).

    Args:
        before: Features before each step, float64 (T, N, D).
        after: Features of what it led to; the final ones where an episode ended.
        starts: Whether an episode starts there, bool (T, N); then C has what it begins with alone.
        inverses: C^-1 of each environment before the first timestep.
        ridge: Weight of the identity in C.
    """
    fresh, bonuses = first_inverse(before.shape[2], ridge=ridge), []
    for seen, led_to, start in zip(before, after, starts, strict=True):
        _, begun = _with(fresh.expand_as(inverses), seen)
        inverses = torch.where(start[:, None, None], begun, inverses)
        bonus, inverses = _with(inverses, led_to)
        bonuses.append(bonus)
    return torch.stack(bonuses), inverses


def _with(inverses: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the bonuses of features (N, D), and C^-1 with them (Sherman and Morrison)."""
    along = (inverses @ features[:, :, None])[:, :, 0]
    bonus = (features * along).sum(dim=1)
    return bonus, inverses - along[:, :, None] * along[:, None, :] / (1 + bonus)[:, None, None]
