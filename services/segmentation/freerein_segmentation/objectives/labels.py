"""Cross-entropy against a label for each timestep."""

import torch
from torch import Tensor

NO_SKILL = -1
"""Label of a timestep that counts for nothing."""


def label_cross_entropy(scores: Tensor, labels: Tensor) -> Tensor:
    """Returns the mean over labelled timesteps of -log P(y_t), float (B,); 0 for a trajectory without any.

    Args:
        scores: float (B, T, K).
        labels: int64 (B, T), `NO_SKILL` for timesteps that are rejected, or padding.
    """
    labelled = labels != NO_SKILL
    losses = -scores.log_softmax(dim=2).gather(2, labels.clamp(min=0)[:, :, None])[:, :, 0]  # (B, T)
    return losses.where(labelled, torch.zeros_like(losses)).sum(dim=1) / labelled.sum(dim=1).clamp(min=1)
