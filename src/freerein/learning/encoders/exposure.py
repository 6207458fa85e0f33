"""Exposure: frames as bright as the training frames were."""

import torch
from torch import Tensor, nn

_COMPARED = 16
"""Rows and columns of the pixels whose ratios are compared, about."""

_LEAST = 0.05
"""Least ratio: darker frames cannot be brightened."""


class ExposureNormalisation(nn.Module):
    """Divides a frame by the median of its ratios to the mean image, of a camera that does not move.

    Most pixels show what does not move, whatever an object or an arm covers; so the median is that of the light. One
    ratio for all channels leaves a frame its tint, which distinguishes turned hues from other colours.
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
        """Returns frames uint8 (N, H, W, C), as bright as the mean image."""
        rows, columns = (slice(None, None, max(1, side // _COMPARED)) for side in frames.shape[1:3])
        ratios = frames[:, rows, columns].float() / self.mean_image[rows, columns]
        light = ratios.flatten(1).median(dim=1).values.clamp(min=_LEAST)  # (N,)
        return (frames / light[:, None, None, None]).round_().clamp_(0, 255).to(torch.uint8)
