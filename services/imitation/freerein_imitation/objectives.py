"""Losses of chapter 3: which action leads to a goal (eq. 3.2), where it leads (eq. 3.4), and whether a goal is near.

And of section 2.4: what a skill does, and whether it ends; of section 4.3: what policies do that are distilled.
"""

from torch import Tensor
from torch.nn import functional


def action_cross_entropy(scores: Tensor, executed: Tensor) -> Tensor:
    """Returns L(a_t, â_t) of eq. 3.2, the mean over the numbers of an action: float (...).

    Args:
        scores: Of the predicted action's categories, float (..., A, categories).
        executed: The code of the executed action, float (..., A, categories).
    """
    return -(executed * scores.log_softmax(dim=-1)).sum(dim=-1).mean(dim=-1)


def squared_error(predicted: Tensor, features: Tensor) -> Tensor:
    """Returns the mean over features of (phi(x_{t+1}) - f(phi(x_t), a))^2, both forward terms of eq. 3.4: float (...).

    The dissertation sums over features.

    Args:
        predicted: f of the executed action, or of the predicted one; float (..., D).
        features: phi(x_{t+1}), float (..., D).
    """
    return (predicted - features).square().mean(dim=-1)


def recognition(scores: Tensor, close: Tensor, far: Tensor, elsewhere: Tensor) -> Tensor:
    """Returns the logistic loss of the goal recognizer, with as much weight on close pairs as on all others: float ().

    Half of the others' weight is on pairs of one trajectory: without them it would be enough to tell scenes apart.

    Args:
        scores: Of pairs to be close, float (N, N).
        close: Pairs a few steps apart, bool (N, N).
        far: Pairs of one trajectory, more than the margin apart, bool (N, N).
        elsewhere: Pairs of different trajectories, bool (N, N).
    """
    negative = functional.softplus(scores)
    others = (masked_mean(negative, far) + masked_mean(negative, elsewhere)) / 2
    return (masked_mean(functional.softplus(-scores), close) + others) / 2


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Returns the mean of the values where the mask is true, 0 where it is true nowhere: float ()."""
    return values.where(mask, 0.0).sum() / mask.sum().clamp(min=1)


def action_squared_error(predicted: Tensor, executed: Tensor) -> Tensor:
    """Returns the mean over the numbers of an action of (a_t - a)^2, the L2 loss of section 4.3: float (...).

    Where policies differ about an observation, the best answer is their mean, which may be what none of them does.

    Args:
        predicted: Float (..., A).
        executed: Float (..., A).
    """
    return (predicted - executed).square().mean(dim=-1)


def absolute_error(predicted: Tensor, executed: Tensor) -> Tensor:
    """Returns the mean over the numbers of an action of |a_t - a|: float (...).

    Where demonstrators differ, the best answer is the median of what they do: something that one of them does.

    Args:
        predicted: Float (..., A).
        executed: Float (..., A).
    """
    return (predicted - executed).abs().mean(dim=-1)


def ending(logits: Tensor, ends: Tensor, goes_on: Tensor) -> Tensor:
    """Returns the logistic loss of the end head, float (), with as much weight on ends as on all other timesteps.

    Args:
        logits: Float (...).
        ends: Timesteps that end a skill, bool (...).
        goes_on: Timesteps in which it goes on, bool (...).
    """
    return (masked_mean(functional.softplus(-logits), ends) + masked_mean(functional.softplus(logits), goes_on)) / 2
