"""What only colour moments allow: skills attend to the features of colours, and frames can be shifted.

A few attention heads per skill choose whose position matters; differences between heads are relative positions. What is
learned of one skill so serves all. Networks whose encoder has other features have no `ColourAttention`.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.learning.encoders.colour_codebook import MOMENTS, shift_horizontally

_HEADS = 8
_PAIRS = _HEADS * (_HEADS - 1) // 2
_GAIN = 10.0  # positions are in [-1, 1], and a few hundredths decide whether a grasp succeeds
_PRESENCE_FLOOR = 0.05


class ColourAttention(nn.Module):
    """Attention of skills over colours; colours of several cameras count as different ones.

    Args:
        cameras: Number of cameras.
        features: Features per camera: `MOMENTS` for each of as many colours as fit, then zeros.
        skills: Number of skills.

    Attributes:
        size: Numbers that `forward` returns per timestep.
    """

    size = _HEADS * MOMENTS + 2 * _PAIRS

    def __init__(self, *, cameras: int, features: int, skills: int) -> None:
        super().__init__()
        self._cameras, self._padding = cameras, features % MOMENTS
        self.logits = nn.Linear(skills, _HEADS * cameras * (features // MOMENTS), bias=False)

    @torch.no_grad()
    def draw(self, generator: torch.Generator) -> None:
        """Draws initial weights that attend to different colours; the generator is on the CPU."""
        self.logits.weight.normal_(generator=generator)

    def forward(self, features: Tensor, skills: Tensor) -> Tensor:
        """Returns attended moments and relative positions of heads, float32 (B, T, size).

        Absent colours get little attention: the logarithm of a colour's mass is added to its logit.

        Args:
            features: float32 (B, T, cameras * features).
            skills: One-hot, float32 (B, T, skills).
        """
        moments = self._moments(features).flatten(2, 3)  # (B, T, colours of all cameras, MOMENTS)
        logits = self.logits(skills).unflatten(2, (_HEADS, -1))  # (B, T, heads, colours)
        presence = (moments[..., 0].clamp(min=0) + _PRESENCE_FLOOR).log()  # (B, T, colours)
        attended = (logits + presence[:, :, None]).softmax(dim=3) @ moments  # (B, T, heads, MOMENTS)
        first, second = torch.triu_indices(_HEADS, _HEADS, offset=1, device=moments.device)
        relative = attended[:, :, first, 1:3] - attended[:, :, second, 1:3]  # (B, T, pairs, 2)
        return torch.cat([_GAIN / 2 * attended.flatten(2), _GAIN * relative.flatten(2)], dim=2)

    def shift(self, features: Tensor, shift: Tensor) -> Tensor:
        """Returns features as if the foreground of all cameras lay further to the right, float32 (B, T, ...).

        Args:
            features: float32 (B, T, cameras * features).
            shift: float32 (B,), in halves of the frame's width.
        """
        shifted = shift_horizontally(self._moments(features), shift).flatten(3)  # (B, T, cameras, colours * MOMENTS)
        return functional.pad(shifted, (0, self._padding)).flatten(2)

    def _moments(self, features: Tensor) -> Tensor:
        """Returns the moments of each camera's colours, float32 (B, T, cameras, colours, MOMENTS)."""
        by_camera = features.reshape(*features.shape[:2], self._cameras, -1)  # (B, T, cameras, features)
        colours = by_camera[..., : by_camera.shape[3] - self._padding]
        return colours.reshape(*colours.shape[:3], -1, MOMENTS)
