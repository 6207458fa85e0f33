"""From heat to a keypoint: the best cell, the mean of all cells, or the middle of a peak."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import torch
from torch import Tensor
from torch.nn import functional

_FINER = 4
"""Times that heat is enlarged before its peak is looked for."""

_SHARPNESS = 20.0
"""Inverse temperature of the soft argmax, of heat over its peak."""

_PEAK_RADIUS = 0.1
"""Half-width of the window around a peak, as a fraction of the image."""

_PEAK_FLOOR = 0.3
"""Fraction of the peak below which heat does not count for the centroid."""


def argmax(heat: Tensor) -> Tensor:
    """Returns the middle of each heatmap's best cell, as the dissertation does: see `centroid`."""
    height, width = heat.shape[2:]
    at = heat.flatten(start_dim=2).argmax(dim=2)  # (N, P)
    return torch.stack([(at % width + 0.5) / width, (at // width + 0.5) / height], dim=2)


def soft_argmax(heat: Tensor) -> Tensor:
    """Returns the mean of all positions, weighted by the softmax of heat over its peak: see `centroid`."""
    fine = _enlarged(heat)
    peaks = fine.amax(dim=(2, 3), keepdim=True).clamp(min=1e-12)
    share = (_SHARPNESS * fine / peaks).flatten(start_dim=2).softmax(dim=2).view_as(fine)
    rows, columns = _middles(fine)
    return torch.stack([(share.sum(dim=2) * columns).sum(dim=2), (share.sum(dim=3) * rows).sum(dim=2)], dim=2)


def centroid(heat: Tensor) -> Tensor:
    """Returns the centroid of each heatmap's peak (N, P, h, w) as fractions of width and height: (N, P, 2)."""
    fine = _enlarged(heat)
    peaks, at = fine.flatten(start_dim=2).max(dim=2)  # (N, P)
    rows, columns = _middles(fine)
    width = len(columns)
    near_rows = (rows - rows[at // width][..., None]).abs() <= _PEAK_RADIUS  # (N, P, 4 h)
    near_columns = (columns - columns[at % width][..., None]).abs() <= _PEAK_RADIUS
    core = (fine - _PEAK_FLOOR * peaks[..., None, None]).relu() + 1e-12
    core = core * near_rows[..., :, None] * near_columns[..., None, :]
    share = core / core.sum(dim=(2, 3), keepdim=True)
    return torch.stack([(share.sum(dim=2) * columns).sum(dim=2), (share.sum(dim=3) * rows).sum(dim=2)], dim=2)


KEYPOINTS: Mapping[str, Callable[[Tensor], Tensor]] = MappingProxyType(
    {"argmax": argmax, "soft_argmax": soft_argmax, "centroid": centroid}
)
"""Ways from heat to a keypoint, by name; configurations call it `place`."""


def _enlarged(heat: Tensor) -> Tensor:
    return functional.interpolate(heat, scale_factor=_FINER, mode="bilinear", align_corners=False)


def _middles(heat: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the middles of rows and of columns of heat (..., h, w), as fractions: (h,), (w,)."""
    height, width = heat.shape[2:]
    rows, columns = (torch.arange(cells, device=heat.device) for cells in (height, width))
    return (rows + 0.5) / height, (columns + 0.5) / width
