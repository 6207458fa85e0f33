"""Features, and image statistics, of many frames."""

import sys

import torch
from torch import Tensor, nn

from freerein.learning.image_statistics import image_statistics
from freerein.learning.in_distribution import KNOWN_FRAMES
from freerein.learning.trajectories import Trajectories

_ENCODE_BATCH = 256


@torch.no_grad()
def encode_trajectory(encoder: nn.Module, trajectories: Trajectories, item: int, *, most: int = sys.maxsize) -> Tensor:
    """Returns the features of a trajectory's first `most` frames, float32 (T, D), on the encoder's device."""
    device, length = next(encoder.buffers()).device, min(len(trajectories.actions[item]), most)
    parts = [
        encoder(
            {
                camera: torch.tensor(each[item][start : min(start + _ENCODE_BATCH, length)], device=device)
                for camera, each in trajectories.frames.items()
            }
        )
        for start in range(0, length, _ENCODE_BATCH)
    ]
    return torch.cat(parts)


def sampled_statistics(trajectories: Trajectories) -> Tensor:
    """Returns image statistics of about `KNOWN_FRAMES` frames, float32 (N, D)."""
    return image_statistics(trajectories.sample_frames(KNOWN_FRAMES))


def trajectory_statistics(trajectories: Trajectories) -> Tensor:
    """Returns image statistics of every frame, trajectory after trajectory, float32 (N, D)."""
    return torch.cat(
        [
            image_statistics({name: torch.tensor(each[item]) for name, each in trajectories.frames.items()})
            for item in range(len(trajectories))
        ]
    )
