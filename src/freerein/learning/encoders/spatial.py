"""An encoder that keeps spatial layout."""

import math

from torch import Tensor, nn
from torch.nn import functional

from freerein.learning.encoders.mean_image import PatchStem

_PATCHES = 16
_CHANNELS = 32


class SpatialEncoder(PatchStem):
    """A small CNN that keeps spatial layout: about 16 x 16 patches, two strided 3 x 3 convolutions, a dense layer.

    Frames are as in `PatchEncoder`.
    """

    def __init__(self, *, height: int, width: int, channels: int, features: int) -> None:
        super().__init__(height=height, width=width, channels=channels, patches=_PATCHES, outputs=_CHANNELS)
        self.conv1 = nn.Conv2d(_CHANNELS, _CHANNELS, kernel_size=3, stride=2, padding=1)
        self.conv2 = nn.Conv2d(_CHANNELS, _CHANNELS, kernel_size=3, stride=2, padding=1)
        cells = math.prod(math.ceil(side / self.stem.stride[0] / 4) for side in (height, width))
        self.head = nn.Linear(_CHANNELS * cells, features)
        self.norm = nn.LayerNorm(features)

    def forward(self, frames: Tensor) -> Tensor:
        """Returns non-negative features, float32 (N, features), of frames uint8 (N, H, W, C)."""
        pixels = self.pixels(frames) - self.padded_mean()  # unlike an offset of patches, needs no gradient
        weight, side = self.stem.weight / self.pixel_std, self.stem.stride
        x = functional.relu(functional.conv2d(pixels, weight, self.stem.bias, stride=side))
        x = functional.relu(self.conv1(x))  # (N, spatial, rows / 2, columns / 2)
        x = functional.relu(self.conv2(x))  # (N, spatial, rows / 4, columns / 4)
        return functional.relu(self.norm(self.head(x.flatten(start_dim=1))))
