"""Actions as categories, which is what the cross-entropy of eq. 3.2 compares: discrete as they are, continuous in bins.

Each number of a continuous action has its own categories, `BINS` values spread evenly over [-1, 1]. A value between two
of them is divided among both, so that the mean of its code is the value itself, and that of a predicted distribution
has no error of rounding.
"""

import torch
from torch import Tensor
from torch.nn import functional

BINS = 11


def encode(actions: Tensor, *, choices: int) -> Tensor:
    """Returns the distribution over categories that stands for each number of an action.

    Args:
        actions: float32 (..., A) in [-1, 1] where `choices` is 0, else int64 (..., 1); -1 for none.
        choices: How many different actions there are when they are discrete, else 0.

    Returns:
        float32 (..., A, categories), sums of 1; zeros for none.
    """
    if choices:
        categories = torch.arange(choices, device=actions.device)
        return (actions[..., None] == categories).float()  # (..., 1, choices)
    place = (actions.clamp(-1, 1) + 1) * (BINS - 1) / 2  # (..., A), in [0, BINS - 1]
    below = place.floor().clamp(max=BINS - 2).long()
    above_share = (place - below)[..., None]
    lower, upper = functional.one_hot(below, BINS), functional.one_hot(below + 1, BINS)  # (..., A, BINS)
    return lower * (1 - above_share) + upper * above_share


def decode(scores: Tensor, *, choices: int) -> Tensor:
    """Returns the action to take: the mean of a continuous one, float32 (..., A); the likeliest discrete one, int64.

    Args:
        scores: float32 (..., A, categories), before the softmax.
        choices: As for `encode`.
    """
    if choices:
        return scores.argmax(dim=-1)
    return scores.softmax(dim=-1) @ torch.linspace(-1, 1, BINS, device=scores.device)
