"""Batches of trajectories with their tags; there are no labels of timesteps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from freerein.learning.augmentation import augment_camera
from freerein.learning.encoders import FrameTensors
from freerein.learning.trajectories import Trajectories
from freerein_segmentation.model import ModelSpec


@dataclass(frozen=True, eq=False)
class TrajectoryBatch:
    """Concatenated trajectories.

    Attributes:
        frames: By camera, uint8 (N, H, W, C).
        actions: float32 (N, A) or int64 (N, 1).
        lengths: int64 (B,), timesteps of each trajectory, with sum N.
        tags: bool (B, K), skills of each trajectory.
    """

    frames: FrameTensors
    actions: Tensor
    lengths: Tensor
    tags: Tensor

    def augmented(self, strength: float, *, generator: torch.Generator) -> "TrajectoryBatch":
        """Returns the trajectories as other cameras would have seen them, each by one camera; tags stay."""
        takes = torch.arange(len(self.lengths)).repeat_interleave(self.lengths.cpu())
        frames = {
            camera: augment_camera(each, takes, strength=strength, generator=generator)
            for camera, each in self.frames.items()
        }
        return replace(self, frames=frames)


def gather(
    trajectories: Trajectories,
    items: Sequence[int],
    phases: Sequence[int],
    *,
    spec: ModelSpec,
    device: torch.device,
) -> TrajectoryBatch:
    """Returns every `spec.stride`-th timestep of some trajectories, as tensors on a device.

    `phases` are the first timestep of each, modulo its length.
    """
    times = [
        slice(phase % len(trajectories.actions[item]), None, spec.stride)
        for item, phase in zip(items, phases, strict=True)
    ]
    places = list(zip(items, times, strict=True))
    actions = [trajectories.actions[item][at] for item, at in places]
    tags = [[skill in trajectories.skills[item] for skill in spec.skills] for item in items]
    return TrajectoryBatch(
        trajectories.frames_at(places, device),
        torch.from_numpy(np.concatenate(actions)).to(device),
        torch.tensor([len(each) for each in actions], device=device),
        torch.tensor(tags, device=device),
    )
