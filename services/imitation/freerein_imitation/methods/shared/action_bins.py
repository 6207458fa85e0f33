"""Actions as categorical distributions, the targets of the cross-entropy of eq. 3.2.

Discrete actions are one-hot. Each number of a continuous action has `BINS` bins spread evenly over [-1, 1]; a value
between two of them is split linearly among both, so that the mean of its distribution is the value itself.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional

BINS = 11


def encode(actions: Tensor, *, choices: int) -> Tensor:
    """Returns the target distribution of each number of an action: float32 (..., A, categories), zeros for no action.

    Args:
        actions: float32 (..., A) in [-1, 1] where `choices` is 0, else int64 (..., 1), -1 for no action.
        choices: Number of discrete actions; 0 for continuous ones.
    """
    if choices:
        categories = torch.arange(choices, device=actions.device)
        return (actions[..., None] == categories).float()  # (..., 1, choices)
    return split(actions, bins=BINS)


def decode(logits: Tensor, *, choices: int) -> Tensor:
    """Returns the mean continuous action, float32 (..., A), or the likeliest discrete one, int64 (..., 1).

    Args:
        logits: float32 (..., A, categories).
        choices: As for `encode`.
    """
    if choices:
        return logits.argmax(dim=-1)
    return logits.softmax(dim=-1) @ centres(logits.device)


def decode_mode(logits: Tensor) -> Tensor:
    """Returns the mean of the likeliest bin and its neighbours alone, float32 (..., A), of logits (..., A, BINS)."""
    off = torch.arange(BINS, device=logits.device) - logits.argmax(dim=-1, keepdim=True)
    return decode(logits.masked_fill(off.abs() > 1, -math.inf), choices=0)


def split(values: Tensor, *, bins: int) -> Tensor:
    """Returns values, float32 (...) in [-1, 1], each split linearly between two of `bins` bins: float32 (..., bins)."""
    position = (values.clamp(-1, 1) + 1) * (bins - 1) / 2  # (...), in [0, bins - 1]
    lower_bin = position.floor().clamp(max=bins - 2).long()
    upper_weight = (position - lower_bin)[..., None]
    lower, upper = functional.one_hot(lower_bin, bins), functional.one_hot(lower_bin + 1, bins)  # (..., bins)
    return lower * (1 - upper_weight) + upper * upper_weight


def centres(device: torch.device) -> Tensor:
    """Returns the values in the middle of the bins, float32 (BINS,)."""
    return torch.linspace(-1, 1, BINS, device=device)
