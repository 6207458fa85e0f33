"""Losses of the goal-conditioned policy (chapter 3), of skills (section 2.4) and of distillation (section 4.3)."""

from torch import Tensor
from torch.nn import functional


def action_cross_entropy(logits: Tensor, target: Tensor) -> Tensor:
    """Returns L(a_t, â_t) of eq. 3.2, the mean over the numbers of an action: float (...).

    Args:
        logits: float (..., A, categories).
        target: Distribution of the executed action, float (..., A, categories).
    """
    return -(target * logits.log_softmax(dim=-1)).sum(dim=-1).mean(dim=-1)


def squared_error(predicted: Tensor, target: Tensor) -> Tensor:
    """Returns the mean squared error over the last axis: float (...).

    It is the L2 action loss of section 4.3, and both forward terms of eq. 3.4, where the dissertation sums.

    Args:
        predicted: float (..., D).
        target: float (..., D).
    """
    return (predicted - target).square().mean(dim=-1)


def absolute_error(predicted: Tensor, target: Tensor) -> Tensor:
    """Returns the mean absolute error over the last axis: float (...); its minimum is the median of demonstrations.

    Args:
        predicted: float (..., D).
        target: float (..., D).
    """
    return (predicted - target).abs().mean(dim=-1)


def recognizer_loss(logits: Tensor, close: Tensor, far: Tensor, other_trajectory: Tensor) -> Tensor:
    """Returns the balanced logistic loss of the goal recognizer: float ().

    Close pairs weigh as much as all others; of those, pairs of one trajectory weigh half, since else it would be enough
    to tell scenes apart.

    Args:
        logits: Logits of pairs to be close, float (N, N).
        close: Pairs a few steps apart, bool (N, N).
        far: Pairs of one trajectory that are further apart, bool (N, N).
        other_trajectory: Pairs of different trajectories, bool (N, N).
    """
    negative = functional.softplus(logits)
    others = (masked_mean(negative, far) + masked_mean(negative, other_trajectory)) / 2
    return (masked_mean(functional.softplus(-logits), close) + others) / 2


def termination_loss(logits: Tensor, terminates: Tensor, continues: Tensor) -> Tensor:
    """Returns the balanced logistic loss of the termination head: float ().

    Args:
        logits: float (...).
        terminates: Timesteps at which a skill terminates, bool (...).
        continues: Timesteps at which it continues, bool (...).
    """
    positive = masked_mean(functional.softplus(-logits), terminates)
    return (positive + masked_mean(functional.softplus(logits), continues)) / 2


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Returns the mean of the values where the mask is true, 0 where it is true nowhere: float ()."""
    return values.where(mask, 0.0).sum() / mask.sum().clamp(min=1)


def relative_error(predicted: Tensor, target: Tensor) -> Tensor:
    """Returns the mean over the last axis of absolute errors, smaller where the target is far: float (...).

    An error of a target of 2 counts half, and that of a larger one in proportion to it.

    Args:
        predicted: float (..., D).
        target: float (..., D).
    """
    return ((predicted - target).abs() / (1 + target.abs() / 2)).mean(dim=-1)


def heat_map_cross_entropy(logits: Tensor, centres: Tensor, place: Tensor, *, width: Tensor) -> Tensor:
    """Returns the cross-entropy of a heat map and a Gaussian around a place: float (N,).

    Args:
        logits: Of cells, float (N, cells).
        centres: Places of the cells, float (cells, 2).
        place: float (N, 2).
        width: Standard deviation along each axis, float (2,).
    """
    offsets = (centres - place[:, None]) / width  # (N, cells, 2)
    target = (-offsets.square().sum(dim=2) / 2).softmax(dim=1)
    return -(target * logits.log_softmax(dim=1)).sum(dim=1)
