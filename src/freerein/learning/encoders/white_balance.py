"""White balance: frames as they would be in the light of the training frames."""

import torch
from torch import Tensor, nn

_STRIDE = 2
"""Of the pixels whose ratios are compared, along both axes."""

_LEAST = 0.05
"""Of a ratio: what is darker than that cannot be brightened."""


class WhiteBalance(nn.Module):
    """Divides each channel of a frame by the median of its ratios to the mean image of a camera that does not move.

    Most pixels show what does not move, whatever an object or an arm covers; so the median is that of the light.
    """

    mean_image: Tensor

    def __init__(self, *, height: int, width: int, channels: int) -> None:
        super().__init__()
        self.register_buffer("mean_image", torch.ones(height, width, channels))

    @torch.no_grad()
    def fit(self, frames: Tensor) -> None:
        """Sets the mean image from training frames, uint8 (N, H, W, C)."""
        self.mean_image.copy_(frames.float().mean(dim=0).clamp(min=1.0))

    def forward(self, frames: Tensor) -> Tensor:
        """Returns frames uint8 (N, H, W, C) in the light of the mean image."""
        some = (slice(None, None, _STRIDE),) * 2
        ratios = frames[:, *some].float() / self.mean_image[*some]
        light = ratios.flatten(1, 2).transpose(1, 2).median(dim=2).values.clamp(min=_LEAST)  # (N, C)
        return (frames / light[:, None, None]).round_().clamp_(0, 255).to(torch.uint8)
