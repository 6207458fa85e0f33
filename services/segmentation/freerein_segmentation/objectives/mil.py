"""Multiple-instance learning, baselines of chapter 2: one timestep stands for each skill, or three."""

import torch
from torch import Tensor

from freerein_segmentation.objectives.tags import mask_scores, tag_cross_entropy


def mil(scores: Tensor, mask: Tensor, tags: Tensor) -> Tensor:
    """Returns the loss of max pooling over time: of each skill only the timestep of its highest score is trained.

    The rest is as in `lse`, so that only the pooling differs.
    """
    return tag_cross_entropy(mask_scores(scores, mask).amax(dim=1), tags)


def fcn_mil(scores: Tensor, mask: Tensor, tags: Tensor) -> Tensor:
    """Returns `mil` with the mean score of k = 3 timesteps: of each skill its highest and one on each side of it.

    As Pathak et al., "Fully convolutional multi-class multiple instance learning", 2015, with the dissertation's k.
    At an end of a trajectory the mean is over two.
    """
    peak = mask_scores(scores, mask).argmax(dim=1, keepdim=True)  # (B, 1, K)
    places = peak + torch.tensor([-1, 0, 1], device=scores.device)[:, None]  # (B, 3, K)
    nearest = places.clamp(0, scores.shape[1] - 1)
    inside = (places == nearest) & mask[:, :, None].expand_as(scores).gather(1, nearest)  # (B, 3, K)
    summed = scores.gather(1, nearest).where(inside, 0.0).sum(dim=1)  # (B, K)
    return tag_cross_entropy(summed / inside.sum(dim=1), tags)
