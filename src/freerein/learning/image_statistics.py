"""The looks of an image in a few numbers that nothing was trained for.

They are colour and contrast of each part of it, its brightness, and how colourful it is.

A network learns to ignore what does not matter for its answers; its features cannot tell noise from a picture.
"""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning.encoders import FrameTensors
from freerein.types.common import Camera

_GRID = 8
"""Parts along each side of an image."""

_CELLS = 32
"""Cells along each side of an image whose colours are compared; what is smaller is noise."""

_SHARES = (0.5, 0.9, 0.99)
"""Quantiles of the cells' colourfulness."""

_DARKEST, _GREYEST = 1 / 64, 0.02
"""Added before logarithms are taken of levels, and of colourfulness."""

_FRAMES_AT_ONCE = 16


def image_statistics(frames: FrameTensors, *, colours: bool = False) -> Tensor:
    """Returns mean colour and contrast in a grid, float32 (N, D), of frames by camera, uint8 (N, H, W, C).

    With `colours`, brightness and colourfulness of each camera's frames follow. A cell is colourful as far as its hue
    and saturation differ from the frame's median ones.
    """
    kinds = [_layout, _colours] if colours else [_layout]
    return torch.cat([torch.cat(list(map(kind, _parts(each)))) for kind in kinds for each in frames.values()], dim=1)


def statistics_sizes(cameras: Sequence[Camera], *, colours: bool = False) -> tuple[int, ...]:
    """Returns the numbers of statistics of each kind, with sum D, of frames of some cameras."""
    layout = sum(_GRID * _GRID * (camera.channels + 1) for camera in cameras)
    return (layout, (1 + len(_SHARES)) * len(cameras)) if colours else (layout,)


def _parts(frames: Tensor) -> Iterator[Tensor]:
    """Yields pixels, float32 (n, C, H, W) in [0, 1], of a few frames at once."""
    is_graph = torch.compiler.is_exporting()  # which cannot loop over frames
    for part in (frames,) if is_graph else torch.split(frames, _FRAMES_AT_ONCE):
        yield part.permute(0, 3, 1, 2).float() / 255


def _layout(pixels: Tensor) -> Tensor:
    """Returns mean colour and contrast of each part, float32 (N, D), of pixels (N, C, H, W)."""
    mean = functional.adaptive_avg_pool2d(pixels, _GRID)  # (N, C, grid, grid)
    square = functional.adaptive_avg_pool2d(pixels.square(), _GRID)
    contrast = (square - mean.square()).clamp(min=0).sqrt().mean(dim=1, keepdim=True)  # (N, 1, grid, grid)
    return torch.cat([mean, contrast], dim=1).flatten(start_dim=1)


def _colours(pixels: Tensor) -> Tensor:
    """Returns mean log brightness and quantiles of log colourfulness, float32 (N, D), of pixels (N, C, H, W)."""
    levels = (functional.adaptive_avg_pool2d(pixels, _CELLS) + _DARKEST).log().flatten(start_dim=2)  # (N, C, cells)
    brightness = levels.mean(dim=1, keepdim=True)
    ratios = levels - brightness
    colourfulness = (ratios - ratios.median(dim=2, keepdim=True).values).norm(dim=1)  # (N, cells)
    shares = torch.quantile(colourfulness, torch.tensor(_SHARES, device=pixels.device), dim=1).T
    return torch.cat([brightness.mean(dim=2), (shares + _GREYEST).log()], dim=1)
