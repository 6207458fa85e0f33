"""Image encoders: frames uint8 (N, H, W, C) to feature vectors."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

_PATCHES, _FINE_PATCHES = 11, 16
_STEM, _BODY = 24, 48
_SPATIAL = 32


class _PatchStem(nn.Module):
    """Subtracts the mean image and embeds square patches, about `patches` along the longer side, by a convolution."""

    mean_image: Tensor
    pixel_std: Tensor

    def __init__(self, *, height: int, width: int, channels: int, patches: int, outputs: int) -> None:
        super().__init__()
        side = math.ceil(max(height, width) / patches)
        self._padding = (0, -width % side, 0, -height % side)  # no pixel is dropped
        self.stem = nn.Conv2d(channels, outputs, kernel_size=side, stride=side)
        self.register_buffer("mean_image", torch.empty(channels, height, width))
        self.register_buffer("pixel_std", torch.empty(()))

    @torch.no_grad()
    def fit_normalisation(self, frames: Tensor) -> None:
        """Sets the mean image and the standard deviation around it from training frames, uint8 (N, H, W, C)."""
        pixels = frames.permute(0, 3, 1, 2).float()  # (N, C, H, W)
        self.mean_image.copy_(pixels.mean(dim=0))
        self.pixel_std.copy_((pixels - self.mean_image).std().clamp(min=1.0))

    def _pixels(self, frames: Tensor) -> Tensor:
        """Returns frames uint8 (N, H, W, C) as float32 (N, C, H, W), padded to whole patches, channels last."""
        return functional.pad(frames.permute(0, 3, 1, 2), self._padding).float()

    def _padded_mean(self) -> Tensor:
        """Returns the mean image padded to whole patches, float32 (1, C, H, W)."""
        return functional.pad(self.mean_image, self._padding)[None]


class PatchEncoder(_PatchStem):
    """A small CNN for small data that mostly ignores position: patch embedding, two 3 x 3 convolutions, max pooling.

    About 11 x 11 patches (6 to 10 times faster than a stack of 5 x 5 convolutions); the first 3 x 3 convolution also
    sees patch coordinates (CoordConv). Global max pooling shares what is learned between positions. Frames have height
    and width in pixels, and 1 or 3 channels.
    """

    def __init__(self, *, height: int, width: int, channels: int, features: int) -> None:
        super().__init__(height=height, width=width, channels=channels, patches=_PATCHES, outputs=_STEM)
        self.conv1 = nn.Conv2d(_STEM, _BODY, kernel_size=3, stride=2, padding=1)
        self.coord_conv = nn.Conv2d(2, _BODY, kernel_size=3, stride=2, padding=1, bias=False)
        self.conv2 = nn.Conv2d(_BODY, _BODY, kernel_size=3, padding=1)
        self.head = nn.Linear(_BODY, features)
        self.norm = nn.LayerNorm(features)

    def forward(self, frames: Tensor) -> Tensor:
        """Returns non-negative features, float32 (N, features), of frames uint8 (N, H, W, C)."""
        x = functional.relu(self._patches(frames))  # (N, stem, rows, columns)
        x = functional.relu(self.conv1(x) + self.coord_conv(_coordinates(x)))  # (N, body, rows / 2, columns / 2)
        x = functional.relu(self.conv2(x)).amax(dim=(2, 3))  # (N, body)
        return functional.relu(self.norm(self.head(x)))

    def _patches(self, frames: Tensor) -> Tensor:
        """Returns stem((frames - mean_image) / pixel_std); linear, so that one image is normalised instead of N."""
        weight, side = self.stem.weight / self.pixel_std, self.stem.stride
        offset = functional.conv2d(self._padded_mean(), weight, stride=side)  # (1, stem, rows, columns)
        return functional.conv2d(self._pixels(frames), weight, self.stem.bias, stride=side) - offset


class SpatialEncoder(_PatchStem):
    """A small CNN that keeps spatial layout: about 16 x 16 patches, two strided 3 x 3 convolutions, a dense layer.

    Frames are as in `PatchEncoder`.
    """

    def __init__(self, *, height: int, width: int, channels: int, features: int) -> None:
        super().__init__(height=height, width=width, channels=channels, patches=_FINE_PATCHES, outputs=_SPATIAL)
        self.conv1 = nn.Conv2d(_SPATIAL, _SPATIAL, kernel_size=3, stride=2, padding=1)
        self.conv2 = nn.Conv2d(_SPATIAL, _SPATIAL, kernel_size=3, stride=2, padding=1)
        cells = math.prod(math.ceil(side / self.stem.stride[0] / 4) for side in (height, width))
        self.head = nn.Linear(_SPATIAL * cells, features)
        self.norm = nn.LayerNorm(features)

    def forward(self, frames: Tensor) -> Tensor:
        """Returns non-negative features, float32 (N, features), of frames uint8 (N, H, W, C)."""
        pixels = self._pixels(frames) - self._padded_mean()  # unlike an offset of patches, needs no gradient
        weight, side = self.stem.weight / self.pixel_std, self.stem.stride
        x = functional.relu(functional.conv2d(pixels, weight, self.stem.bias, stride=side))
        x = functional.relu(self.conv1(x))  # (N, spatial, rows / 2, columns / 2)
        x = functional.relu(self.conv2(x))  # (N, spatial, rows / 4, columns / 4)
        return functional.relu(self.norm(self.head(x.flatten(start_dim=1))))


def _coordinates(x: Tensor) -> Tensor:
    """Returns the row and column of each cell of x (N, C, rows, columns), in [-1, 1]: (1, 2, rows, columns)."""
    axes = (torch.linspace(-1, 1, cells, dtype=x.dtype, device=x.device) for cells in x.shape[2:])
    return torch.stack(torch.meshgrid(*axes, indexing="ij"))[None]
