"""Keypoints of noun phrases by their embeddings: a phrase is compared with each cell of a feature map.

The probability of the cells, and that the phrase is nowhere, is a softmax, as of CLIP's features without pooling
(MaskCLIP: Zhou et al., "Extract free dense labels from CLIP", 2022). No channel belongs to a phrase: one that no fit
has seen has a keypoint, too, as far as text and image encoder know what it names.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from freerein.learning.encoders.clip import peak_centroids

INITIAL_LOGIT = 8.0
"""Logit, at first, of a heat at which the grounding model says that presence is 1/2, and of being nowhere."""


class Located(NamedTuple):
    """Locations of K phrases in N images.

    Attributes:
        logits: float32 (N, K, S + 1), of each of S cells, row by row, and of nowhere.
        keypoints: float32 (N, K, 2), x and y as fractions of width and height.
        presence: float32 (N, K), probability of not being nowhere.
    """

    logits: Tensor
    keypoints: Tensor
    presence: Tensor


class Locator(nn.Module):
    """Finds phrases in cells.

    Args:
        phrase_dim: D, dimension of the embeddings of phrases and cells.
    """

    def __init__(self, phrase_dim: int) -> None:
        super().__init__()
        self.contrast = nn.Parameter(torch.empty(phrase_dim))
        self.log_scale = nn.Parameter(torch.empty(()))
        self.nowhere = nn.Parameter(torch.empty(()))

    def initialise(self, _generator: torch.Generator) -> None:
        """Sets the initial values, which are not random."""
        nn.init.zeros_(self.contrast)
        nn.init.zeros_(self.log_scale)
        nn.init.constant_(self.nowhere, INITIAL_LOGIT)

    def forward(self, cells: Tensor, phrases: Tensor) -> Located:
        """Returns where phrases, float32 (K, D), are in cells, float32 (N, h, w, D)."""
        count, height, width, _ = cells.shape
        heat = cells.flatten(1, 2) @ (self.log_scale.exp() * (phrases - self.contrast)).T  # (N, S, K)
        nowhere = self.nowhere.expand(count, 1, len(phrases))
        logits = torch.cat([heat, nowhere], dim=1).transpose(1, 2)  # (N, K, S + 1)
        probability = logits.softmax(dim=2)
        keypoints = peak_centroids(probability[..., :-1].reshape(count, -1, height, width))
        return Located(logits, keypoints, 1 - probability[..., -1])


def target_distribution(keypoints: Tensor, *, height: int, width: int) -> Tensor:
    """Returns the distribution over cells whose mean is each keypoint, float32 (..., height * width).

    Each keypoint, float (..., 2), x and y as fractions, is shared among the four nearest cells, as in bilinear
    interpolation.
    """
    sides = torch.tensor([width, height], device=keypoints.device)
    at = (keypoints * sides - 0.5).clamp(min=0).minimum(sides - 1.0)  # (..., 2), in cells
    columns, rows = (
        (1 - (at[..., axis, None] - torch.arange(side, device=keypoints.device)).abs()).clamp(min=0)
        for axis, side in enumerate((width, height))
    )
    return (rows[..., :, None] * columns[..., None, :]).flatten(start_dim=-2)
