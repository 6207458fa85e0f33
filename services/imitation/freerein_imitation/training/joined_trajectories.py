"""Timesteps of several trajectories in one batch, trajectory after trajectory."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning.encoders import FrameTensors
from freerein.learning.trajectories import Trajectories


def frames_at(
    trajectories: Trajectories, places: Sequence[tuple[int, slice | npt.NDArray[np.int64]]], device: torch.device
) -> FrameTensors:
    """Returns frames by camera, uint8 (N, H, W, C).

    Args:
        trajectories: The trajectories.
        places: Which of them, and which of its timesteps; a trajectory may come again.
        device: Device of the frames.
    """
    return {
        camera: joined([arrays[item][timesteps] for item, timesteps in places], device)
        for camera, arrays in trajectories.frames.items()
    }


def joined(parts: Sequence[npt.NDArray[Any]], device: torch.device) -> Tensor:
    """Returns arrays (n, ...), one after the other, as a tensor (N, ...)."""
    return torch.from_numpy(np.concatenate(parts)).to(device)
