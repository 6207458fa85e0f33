"""What an image looks like, in a few numbers that nothing was trained for: colour and contrast of each part of it.

A network learns to ignore what does not matter for its answers; its features cannot tell noise from a picture.
"""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning.encoders import FrameTensors
from freerein.types.common import Camera

_GRID = 8
"""Parts along each side of an image."""

_FRAMES_AT_ONCE = 16


def image_statistics(frames: FrameTensors) -> Tensor:
    """Returns mean colour and contrast in a grid, float32 (N, D), of frames by camera, uint8 (N, H, W, C)."""
    return torch.cat([_of_one_camera(each) for each in frames.values()], dim=1)


def statistics_size(cameras: Sequence[Camera]) -> int:
    """Returns D, the number of statistics of frames of some cameras."""
    return sum(_GRID * _GRID * (camera.channels + 1) for camera in cameras)


def _of_one_camera(frames: Tensor) -> Tensor:
    parts = []
    for part in torch.split(frames, _FRAMES_AT_ONCE):
        pixels = part.permute(0, 3, 1, 2).float() / 255  # (N, C, H, W)
        mean = functional.adaptive_avg_pool2d(pixels, _GRID)  # (N, C, grid, grid)
        square = functional.adaptive_avg_pool2d(pixels.square(), _GRID)
        contrast = (square - mean.square()).clamp(min=0).sqrt().mean(dim=1, keepdim=True)  # (N, 1, grid, grid)
        parts.append(torch.cat([mean, contrast], dim=1).flatten(start_dim=1))
    return torch.cat(parts)
