"""Frames that are enlarged by a whole factor, for networks that take no small ones."""

from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

_AXES = (-3, -2)  # of (..., H, W, C)


def enlarged(frames: npt.NDArray[Any], factor: int) -> npt.NDArray[Any]:
    """Returns frames, (..., H, W, C), enlarged by a whole factor: each pixel several times, none blended."""
    return frames if factor == 1 else frames.repeat(factor, axis=-3).repeat(factor, axis=-2)


def enlarged_space(space: spaces.Space[Any], least: int) -> spaces.Space[Any]:
    """Returns the space of enlarged observations, a copy: frames, or a dict of them, are enlarged, and nothing else."""
    if isinstance(space, spaces.Dict):
        return spaces.Dict({name: enlarged_space(part, least) for name, part in space.items()})
    factor = enlargement(space, least)
    if not isinstance(space, spaces.Box) or factor == 1:
        return deepcopy(space)
    return spaces.Box(enlarged(space.low, factor), enlarged(space.high, factor), dtype=np.dtype(space.dtype).type)


def enlargement(space: spaces.Space[Any], least: int) -> int:
    """Returns the factor that enlarges one environment's frames to `least` pixels a side; 1 where there are none."""
    if not isinstance(space, spaces.Box) or len(space.shape) < len(_AXES) + 1:
        return 1
    return max(1, -(-least // min(space.shape[axis] for axis in _AXES)))
