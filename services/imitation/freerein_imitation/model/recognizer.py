"""The goal recognizer of section 3.2: is this observation close to that goal?"""

import torch
from torch import Tensor, nn

from freerein.learning.encoders import SpatialEncoder

_CERTAINTY = 5.0
"""The score of two equal images."""


class GoalRecognizer(nn.Module):
    """Embeds images so that those a few actions apart are less than 1 apart, and the others more.

    The dissertation leaves the network open. A distance cannot call anything closer to a goal than the goal's own
    image, so that what is learned from steps in time orders places as well.

    Args:
        height: Of the frames, in pixels.
        width: In pixels.
        channels: 1 or 3.
        embedding: Dimensions of the embedding.
    """

    def __init__(self, *, height: int, width: int, channels: int, embedding: int) -> None:
        super().__init__()
        self.image = SpatialEncoder(height=height, width=width, channels=channels, features=embedding)
        self.metric = nn.Linear(embedding, embedding, bias=False)

    def forward(self, frames: Tensor) -> Tensor:
        """Returns the embeddings of frames uint8 (N, H, W, C): float32 (N, embedding)."""
        embedded: Tensor = self.metric(self.image(frames))
        return embedded


def closeness(observation: Tensor, goal: Tensor) -> Tensor:
    """Returns the score of embeddings (..., embedding) to be close, float32 (...); its sigmoid is the probability."""
    distance: Tensor = torch.linalg.vector_norm(observation - goal, dim=-1)
    return _CERTAINTY * (1 - distance)
