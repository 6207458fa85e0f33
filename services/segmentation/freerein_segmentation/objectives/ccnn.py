"""Constrained training, a baseline of chapter 2: labels are the nearest distribution that fits the tags.

Written from Pathak, Kraehenbuehl and Darrell, "Constrained convolutional neural networks for weakly supervised
segmentation", 2015, not from its code. For each trajectory the latent distribution P minimises KL(P, Q), Q the
network's, under linear constraints: skills that are not tagged have no mass, and each tagged one has a least share of
the timesteps, up to a penalised slack. With a multiplier for each tag, P_t(c) is proportional to Q_t(c) exp(lambda_c).
"""

import math

import torch
from torch import Tensor

LEAST_SHARE = 0.05
"""Least share of a trajectory's timesteps for each of its tags."""

SLACK_WEIGHT = 2.0
"""Penalty of one missing timestep, in nats; no multiplier exceeds it."""

_ITERATIONS = 40


def ccnn(scores: Tensor, mask: Tensor, tags: Tensor) -> Tensor:
    """Returns the mean over time of KL(P, Q), P the nearest distribution in which each tag has 5 % of the timesteps.

    P is constant, so that the gradient to the scores is Q - P, divided by the number of timesteps.
    """
    return _divergence(scores, mask, nearest_distribution(scores, mask, tags, least_share=LEAST_SHARE))


def ccnn_without_share(scores: Tensor, mask: Tensor, tags: Tensor) -> Tensor:
    """Returns `ccnn` without the least share of each tag."""
    return _divergence(scores, mask, nearest_distribution(scores, mask, tags, least_share=0.0))


@torch.no_grad()
def nearest_distribution(scores: Tensor, mask: Tensor, tags: Tensor, *, least_share: float) -> Tensor:
    """Returns log P, float (B, T, K), minus infinity on skills that are not tagged; arguments as of an `Objective`.

    Dual ascent. Each step solves for all multipliers a lower bound of the dual in which they are separate (generalised
    iterative scaling, Darroch and Ratcliff, 1972: each timestep has mass one), so that the dual never falls and no step
    size is chosen.
    """
    allowed = scores.log_softmax(dim=2).masked_fill(~tags[:, None], float("-inf"))  # (B, T, K)
    if least_share == 0.0:
        return allowed.log_softmax(dim=2)
    multipliers = torch.zeros_like(tags, dtype=scores.dtype)  # (B, K)
    timesteps = mask.sum(dim=1, keepdim=True)
    for _ in range(_ITERATIONS):
        log_p = (allowed + multipliers[:, None]).log_softmax(dim=2)  # (B, T, K)
        log_shares = log_p.masked_fill(~mask[:, :, None], float("-inf")).logsumexp(dim=1) - timesteps.log()  # (B, K)
        multipliers = (multipliers + math.log(least_share) - log_shares).clamp(0.0, SLACK_WEIGHT)
    return (allowed + multipliers[:, None]).log_softmax(dim=2)


def _divergence(scores: Tensor, mask: Tensor, log_p: Tensor) -> Tensor:
    """Returns the mean over time of KL(P, Q), float (B,)."""
    log_q = scores.log_softmax(dim=2)
    terms = (log_p.exp() * (log_p - log_q)).where(log_p.isfinite() & mask[:, :, None], 0.0)  # (B, T, K)
    return terms.sum(dim=(1, 2)) / mask.sum(dim=1)
