"""The first layer of the encoders for a camera that does not move: square patches of frames minus a mean image."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional


class PatchStem(nn.Module):
    """Subtracts the mean image and embeds square patches, about `patches` along the longer side, by a convolution."""

    mean_image: Tensor
    pixel_std: Tensor
    min_features = 1

    def __init__(self, *, height: int, width: int, channels: int, patches: float, outputs: int) -> None:
        super().__init__()
        side = math.ceil(max(height, width) / patches)
        self._padding = (0, -width % side, 0, -height % side)  # no pixel is dropped
        self.stem = nn.Conv2d(channels, outputs, kernel_size=side, stride=side)
        self.register_buffer("mean_image", torch.zeros(channels, height, width))
        self.register_buffer("pixel_std", torch.ones(()))

    @torch.no_grad()
    def fit_normalisation(self, frames: Tensor, *, generator: torch.Generator | None = None) -> None:
        """Sets the mean image and the standard deviation around it from training frames, uint8 (N, H, W, C).

        Nothing is drawn from the generator.
        """
        pixels = frames.permute(0, 3, 1, 2).float()  # (N, C, H, W)
        self.mean_image.copy_(pixels.mean(dim=0))
        self.pixel_std.copy_((pixels - self.mean_image).std().clamp(min=1.0))

    def pixels(self, frames: Tensor) -> Tensor:
        """Returns frames uint8 (N, H, W, C), padded to whole patches: float32 (N, C, H, W).

        They are in channels-last memory format.
        """
        return functional.pad(frames.permute(0, 3, 1, 2), self._padding).float()

    def padded_mean(self) -> Tensor:
        """Returns the mean image padded to whole patches, float32 (1, C, H, W)."""
        return functional.pad(self.mean_image, self._padding)[None]
