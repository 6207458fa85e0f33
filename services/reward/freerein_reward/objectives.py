"""Contrastive losses with several positives per image and per caption.

Rows are images, columns are texts; `scores` are scaled similarities, float (N, K), `positives` bool (N, K).
"""

from torch import Tensor
from torch.nn import functional


def contrastive_loss(scores: Tensor, positives: Tensor) -> Tensor:
    """Returns CLIP's symmetric loss with several positives each (SupCon), a scalar.

    Equal captions of a batch must be one column, so that they are not each other's negatives.
    """
    return 0.5 * (multi_positive_cross_entropy(scores, positives) + multi_positive_cross_entropy(scores.T, positives.T))


def multi_positive_cross_entropy(scores: Tensor, positives: Tensor) -> Tensor:
    """Returns the mean cross-entropy with a uniform target over each row's positives; rows without are ignored."""
    log_probabilities = scores.log_softmax(dim=1)  # (N, K)
    counts = positives.sum(dim=1)  # (N,)
    losses = -log_probabilities.where(positives, 0.0).sum(dim=1) / counts.clamp(min=1)  # (N,)
    return losses.sum() / (counts > 0).sum().clamp(min=1)


def relation_cross_entropy(scores: Tensor, relations: Tensor) -> Tensor:
    """Returns the mean cross-entropy of each pair's relation among rival captions, which is what the reward decides.

    Args:
        scores: float (N, pairs, R), score of the caption with each relation.
        relations: int64 (N, pairs), true relation; -1 where the image has no caption of the pair.
    """
    loss = functional.cross_entropy(scores.flatten(end_dim=1), relations.flatten(), ignore_index=-1, reduction="sum")
    return loss / (relations >= 0).sum().clamp(min=1)
