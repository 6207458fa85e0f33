"""Multiple-instance learning, a baseline of chapter 2: one timestep stands for each skill."""

from torch import Tensor

from freerein_segmentation.objectives.tags import mask_scores, tag_cross_entropy


def mil(scores: Tensor, mask: Tensor, tags: Tensor) -> Tensor:
    """Returns the loss of max pooling over time: of each skill only the timestep of its highest score is trained.

    The rest is as in `lse`, so that only the pooling differs.
    """
    return tag_cross_entropy(mask_scores(scores, mask).amax(dim=1), tags)
