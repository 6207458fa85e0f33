"""The contrastive losses: an image may have several captions that are right, and a caption several images.

Rows are images, columns are texts; `scores` are scaled cosines, float (N, K), `positives` bool (N, K).
"""

from torch import Tensor
from torch.nn import functional


def contrastive(scores: Tensor, positives: Tensor) -> Tensor:
    """Returns CLIP's loss, images to texts and texts to images, with several positives each (SupCon), a scalar.

    Equal captions in a batch are one column, so that they are never each other's negatives.
    """
    return 0.5 * (multi_positive(scores, positives) + multi_positive(scores.T, positives.T))


def multi_positive(scores: Tensor, positives: Tensor) -> Tensor:
    """Returns the cross-entropy to an even share among each row's positives, a scalar; rows without do not count."""
    log_share = scores.log_softmax(dim=1)  # (N, K)
    counts = positives.sum(dim=1)  # (N,)
    losses = -log_share.where(positives, 0.0).sum(dim=1) / counts.clamp(min=1)  # (N,)
    return losses.sum() / (counts > 0).sum().clamp(min=1)


def rivalry(scores: Tensor, relations: Tensor) -> Tensor:
    """Returns how badly the true relation of each pair wins over its rivals: cross-entropy, a scalar.

    The reward asks nothing else: which of the sentences that differ in the relation alone fits the image best.

    Args:
        scores: float (N, pairs, R): of the sentence with each relation.
        relations: int64 (N, pairs): the one that holds; -1 where the image does not show the pair.
    """
    loss = functional.cross_entropy(scores.flatten(end_dim=1), relations.flatten(), ignore_index=-1, reduction="sum")
    return loss / (relations >= 0).sum().clamp(min=1)
