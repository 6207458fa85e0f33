"""Frames that are enlarged by a whole factor, for networks that take no small ones."""

from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

_AXES = (-3, -2)  # of (..., H, W, C)


def enlarged(frames: npt.NDArray[Any], least: int) -> npt.NDArray[Any]:
    """Returns frames, (..., H, W, C), of at least `least` pixels a side: each pixel several times, none blended."""
    factor = _factor(frames.shape, least)
    return frames if factor == 1 else frames.repeat(factor, axis=-3).repeat(factor, axis=-2)


def enlarged_space(space: spaces.Space[Any], least: int) -> spaces.Space[Any]:
    """Returns the space of enlarged observations, a copy: frames, or a dict of them, are enlarged, and nothing else."""
    if isinstance(space, spaces.Dict):
        return spaces.Dict({name: enlarged_space(part, least) for name, part in space.items()})
    if not isinstance(space, spaces.Box) or _factor(space.shape, least) == 1:
        return deepcopy(space)
    return spaces.Box(enlarged(space.low, least), enlarged(space.high, least), dtype=np.dtype(space.dtype).type)


def _factor(shape: tuple[int, ...], least: int) -> int:
    return max(1, -(-least // min(shape[axis] for axis in _AXES))) if len(shape) >= len(_AXES) + 1 else 1
