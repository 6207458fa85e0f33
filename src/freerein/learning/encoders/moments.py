"""Keypoints of things in a frame, to a fraction of a pixel: image moments of learned heat maps."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.learning.encoders.mean_image import PatchStem

_PATCHES = 32
_CHANNELS = 16
_MOMENTS = 5
_GAIN = 4.0  # keypoints are in [-1, 1], and a few hundredths matter
_MASS_SCALE = 20.0  # heat per unit of mass
_MOST_MASS = 5.0
_SHRINKAGE = 0.5  # heat at which a mean is halfway between the frame's centre and where it is
_EPSILON = 1e-6


class MomentsEncoder(PatchStem):
    """About 32 x 32 patches, a heat map per five features, and its mass, mean column and row, and their deviations.

    It is a spatial soft-argmax (Levine et al., "End-to-end training of deep visuomotor policies", 2016) that also tells
    how much there is and how far it extends. Features beyond a multiple of 5 are zeros. Frames are as in
    `PatchEncoder`.
    """

    powers: Tensor
    min_features = _MOMENTS

    def __init__(self, *, height: int, width: int, channels: int, features: int) -> None:
        super().__init__(height=height, width=width, channels=channels, patches=_PATCHES, outputs=_CHANNELS)
        self.heat = nn.Conv2d(_CHANNELS, features // _MOMENTS, kernel_size=1)
        self._padding_features = features % _MOMENTS
        side = self.stem.stride[0]
        y, x = (_centres(math.ceil(length / side)) for length in (height, width))
        rows, columns = y.repeat_interleave(len(x)), x.repeat(len(y))  # (P,) each, patch after patch
        powers = torch.stack([torch.ones_like(rows), columns, rows, columns.square(), rows.square()], dim=1)
        self.register_buffer("powers", powers)

    def forward(self, frames: Tensor) -> Tensor:
        """Returns features, float32 (N, features), of frames uint8 (N, H, W, C)."""
        pixels = self.pixels(frames) - self.padded_mean()
        weight, side = self.stem.weight / self.pixel_std, self.stem.stride
        x = functional.relu(functional.conv2d(pixels, weight, self.stem.bias, stride=side))
        heat = functional.relu(self.heat(x)).square().flatten(start_dim=2)  # (N, maps, P)
        moments = _moments(heat @ self.powers).flatten(start_dim=1)
        return functional.pad(moments, (0, self._padding_features))


def _centres(count: int) -> Tensor:
    """Returns the centres of `count` patches along an axis from -1 to 1, float32 (count,)."""
    return (2 * torch.arange(count) + 1) / count - 1


def _moments(sums: Tensor) -> Tensor:
    """Returns mass, means and deviations, float32 (N, maps, 5), of sums over 1, x, y, x^2 and y^2."""
    mass = sums[..., :1]
    mean, square = (sums[..., 1:] / (mass + _SHRINKAGE)).chunk(2, dim=-1)  # (N, maps, 2) each
    deviation = (square - mean.square()).clamp(min=_EPSILON).sqrt()
    amount = (mass / _MASS_SCALE + _EPSILON).sqrt().clamp(max=_MOST_MASS)
    return torch.cat([amount, _GAIN * mean, 2 * _GAIN * deviation], dim=-1)
