"""Image encoders: frames as they are stored, uint8 with channels last, to feature vectors."""

import math

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

_CELLS = 11
"""Patches along the longer side, about; fewer than 8 lose small objects, more cost time and gain nothing."""


def patch_size(*, height: int, width: int) -> int:
    """Returns the side of the square patches that cut a frame into about 11 along its longer side, in pixels."""
    return max(1, math.ceil(max(height, width) / _CELLS))
