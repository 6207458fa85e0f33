"""What only the colour codebook has: skills attend to its features, moments of colours, and frames can be shifted.

A few attention heads per skill choose whose position matters; differences between heads are relative positions. What is
learned of one skill so serves all. Networks with another encoder have no `ColourAttention`.
"""

import torch
from torch import Tensor, nn

from freerein.learning.encoders.colour_codebook import MOMENTS, shift_horizontally

_HEADS = 8
_PAIRS = _HEADS * (_HEADS - 1) // 2
_GAIN = 10.0  # positions are in [-1, 1], and a few hundredths decide whether a grasp succeeds
_PRESENCE_FLOOR = 0.05


class ColourAttention(nn.Module):
    """Attention of skills over colours; colours of several cameras count as different ones.

    Args:
        features: Features of all cameras: `MOMENTS` per colour.
        skills: Number of skills.

    Attributes:
        size: Numbers that `forward` returns per timestep.
    """

    size = _HEADS * MOMENTS + 2 * _PAIRS

    def __init__(self, features: int, *, skills: int) -> None:
        super().__init__()
        self.logits = nn.Linear(skills, _HEADS * features // MOMENTS, bias=False)

    @torch.no_grad()
    def draw(self, generator: torch.Generator) -> None:
        """Draws initial weights that attend to different colours; the generator is on the CPU."""
        self.logits.weight.normal_(generator=generator)

    def forward(self, features: Tensor, skills: Tensor) -> Tensor:
        """Returns attended moments and relative positions of heads, float32 (B, T, size).

        Absent colours get little attention: the logarithm of a colour's mass is added to its logit.

        Args:
            features: float32 (B, T, colours * MOMENTS).
            skills: One-hot, float32 (B, T, skills).
        """
        moments = features.reshape(*features.shape[:2], -1, MOMENTS)  # (B, T, colours, MOMENTS)
        logits = self.logits(skills).unflatten(2, (_HEADS, -1))  # (B, T, heads, colours)
        presence = (moments[..., 0].clamp(min=0) + _PRESENCE_FLOOR).log()  # (B, T, colours)
        attended = (logits + presence[:, :, None]).softmax(dim=3) @ moments  # (B, T, heads, MOMENTS)
        first, second = torch.triu_indices(_HEADS, _HEADS, offset=1, device=moments.device)
        relative = attended[:, :, first, 1:3] - attended[:, :, second, 1:3]  # (B, T, pairs, 2)
        return torch.cat([_GAIN / 2 * attended.flatten(2), _GAIN * relative.flatten(2)], dim=2)


def shift_colours(features: Tensor, shift: Tensor) -> Tensor:
    """Returns features as if the foreground of all cameras lay further to the right, float32 (B, T, colours * MOMENTS).

    Args:
        features: float32 (B, T, colours * MOMENTS).
        shift: float32 (B,), in halves of the frame's width.
    """
    return shift_horizontally(features.reshape(*features.shape[:2], -1, MOMENTS), shift).flatten(2)
