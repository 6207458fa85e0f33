"""Features of many frames, encoded in batches."""

from collections.abc import Mapping
from typing import Any

import numpy.typing as npt
import torch
from torch import Tensor, nn

from freerein.learning.trajectories import Trajectories

KNOWN_FRAMES = 2000
"""Training frames whose features an in-distribution score is fitted to, about."""

_ENCODE_BATCH = 256


@torch.no_grad()
def encode_frames(encoder: nn.Module, frames: Mapping[str, npt.NDArray[Any]]) -> Tensor:
    """Returns features, float32 (N, D), of frames by camera, uint8 (N, H, W, C), on the encoder's device."""
    device, count = next(encoder.buffers()).device, len(next(iter(frames.values())))
    parts = [
        encoder(
            {name: torch.tensor(each[start : start + _ENCODE_BATCH], device=device) for name, each in frames.items()}
        )
        for start in range(0, count, _ENCODE_BATCH)
    ]
    return torch.cat(parts)


def encode_trajectory(encoder: nn.Module, trajectories: Trajectories, item: int) -> Tensor:
    """Returns the features of each frame of a trajectory, float32 (T, D), on the encoder's device."""
    return encode_frames(encoder, {camera: each[item] for camera, each in trajectories.frames.items()})
