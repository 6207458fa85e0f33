"""The common part of the weakly supervised losses of chapter 2: scores pooled over time are compared with the tags."""

from collections.abc import Callable
from typing import TypeAlias

from torch import Tensor

Objective: TypeAlias = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Given scores f_t(k), float (B, T, K), the mask of valid timesteps, bool (B, T), and the tags C_X, bool (B, K), at
least one per trajectory, returns one loss per trajectory, float (B,)."""


def tag_cross_entropy(pooled: Tensor, tags: Tensor) -> Tensor:
    """Returns -sum_c q(c) log Q(c|X), float (B,): Q the softmax of pooled scores (B, K), q = 1/|C_X| on the tags."""
    log_q = pooled.log_softmax(dim=1)  # (B, K)
    return -log_q.where(tags, 0.0).sum(dim=1) / tags.sum(dim=1)


def mask_scores(scores: Tensor, mask: Tensor) -> Tensor:
    """Returns scores (B, T, K) with those of invalid timesteps, mask (B, T), set to minus infinity."""
    return scores.masked_fill(~mask[:, :, None], float("-inf"))
