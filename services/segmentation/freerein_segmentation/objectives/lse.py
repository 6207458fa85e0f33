"""Log-sum-exp pooling, the dissertation's objective, and its normalised form."""

from torch import Tensor

from freerein_segmentation.objectives.tags import mask_scores, tag_cross_entropy


def lse(scores: Tensor, mask: Tensor, tags: Tensor) -> Tensor:
    """Returns the dissertation's loss: log-sum-exp pooling over time, eq. 2.2, then softmax over skills.

    Q(c|X) is a ratio of total exponential mass, so that a few timesteps with high scores can satisfy it.
    """
    return tag_cross_entropy(pool(scores, mask), tags)


def lse_per_timestep(scores: Tensor, mask: Tensor, tags: Tensor) -> Tensor:
    """Returns `lse` on log-probabilities, so that every timestep has equal weight.

    A departure from the dissertation at the same supervision: Q(c|X) becomes the mean over time of P(y_t = c), eq. 2.1.
    """
    return tag_cross_entropy(pool(scores.log_softmax(dim=2), mask), tags)


def pool(scores: Tensor, mask: Tensor) -> Tensor:
    """Returns g(c; X), eq. 2.2, float (B, K): log-sum-exp over valid timesteps."""
    return mask_scores(scores, mask).logsumexp(dim=1)
