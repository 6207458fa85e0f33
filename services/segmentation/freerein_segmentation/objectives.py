"""Weakly supervised losses of chapter 2: scores are pooled over time and compared with the trajectory's tags.

All take scores f_t(k), float (B, T, K), the mask of valid timesteps, bool (B, T), and the tags C_X, bool (B, K), at
least one per trajectory, and return one loss per trajectory, float (B,). Only the pooling differs.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal, TypeAlias

from torch import Tensor

ObjectiveName: TypeAlias = Literal["lse", "lse_per_timestep"]
Objective: TypeAlias = Callable[[Tensor, Tensor, Tensor], Tensor]


def lse(scores: Tensor, mask: Tensor, tags: Tensor) -> Tensor:
    """Returns the dissertation's loss: log-sum-exp over time, eq. 2.2, then softmax over skills.

    Q(c|X) is a ratio of total exponential mass, so that a few timesteps with high scores can satisfy it.
    """
    return tag_cross_entropy(pool(scores, mask), tags)


def lse_per_timestep(scores: Tensor, mask: Tensor, tags: Tensor) -> Tensor:
    """Returns the same loss on log-probabilities, so that every timestep has equal weight.

    A departure from the dissertation at the same supervision: Q(c|X) becomes the mean over time of P(y_t = c), eq. 2.1.
    """
    return tag_cross_entropy(pool(scores.log_softmax(dim=2), mask), tags)


OBJECTIVES: Mapping[ObjectiveName, Objective] = MappingProxyType({"lse": lse, "lse_per_timestep": lse_per_timestep})


def pool(scores: Tensor, mask: Tensor) -> Tensor:
    """Returns g(c; X), eq. 2.2, float (B, K): log-sum-exp over valid timesteps."""
    return scores.masked_fill(~mask[:, :, None], float("-inf")).logsumexp(dim=1)


def tag_cross_entropy(pooled: Tensor, tags: Tensor) -> Tensor:
    """Returns -sum_c q(c) log Q(c|X), float (B,): Q the softmax of pooled scores (B, K), q = 1/|C_X| on the tags."""
    log_q = pooled.log_softmax(dim=1)  # (B, K)
    return -log_q.where(tags, 0.0).sum(dim=1) / tags.sum(dim=1)
