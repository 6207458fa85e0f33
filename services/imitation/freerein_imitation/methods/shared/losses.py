"""Losses that several methods share."""

from torch import Tensor
from torch.nn import functional


def action_cross_entropy(logits: Tensor, target: Tensor) -> Tensor:
    """Returns L(a_t, â_t) of eq. 3.2, the mean over the numbers of an action: float (...).

    `target` is the distribution of the executed action, float (..., A, categories) as the logits.
    """
    return -(target * logits.log_softmax(dim=-1)).sum(dim=-1).mean(dim=-1)


def squared_error(predicted: Tensor, target: Tensor) -> Tensor:
    """Returns the mean squared error over the last axis of floats (..., D), the L2 action loss of section 4.3."""
    return (predicted - target).square().mean(dim=-1)


def squared_distance(predicted: Tensor, target: Tensor) -> Tensor:
    """Returns the squared L2 norm of the difference of floats (..., D), both forward terms of eq. 3.4: float (...)."""
    return (predicted - target).square().sum(dim=-1)


def termination_loss(logits: Tensor, terminates: Tensor, continues: Tensor) -> Tensor:
    """Returns the balanced logistic loss of the termination head, float (), of logits, float (...).

    `terminates` and `continues`, bool (...), are the timesteps at which a skill does.
    """
    positive = masked_mean(functional.softplus(-logits), terminates)
    return (positive + masked_mean(functional.softplus(logits), continues)) / 2


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Returns the mean of the values where the mask is true, 0 where it is true nowhere: float ()."""
    return values.where(mask, 0.0).sum() / mask.sum().clamp(min=1)
