"""Batches of trajectories with their tags; there are no labels of timesteps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from freerein.learning.augmentation import augment_camera
from freerein.learning.encoders import Frames
from freerein.learning.trajectories import Trajectories
from freerein_segmentation.model import ModelSpec
from freerein_segmentation.objectives.labels import NO_SKILL


@dataclass(frozen=True, eq=False)
class TrajectoryBatch:
    """Concatenated trajectories.

    Attributes:
        frames: By camera, uint8 (N, H, W, C).
        actions: float32 (N, A) or int64 (N, 1).
        lengths: int64 (B,), timesteps of each trajectory, with sum N.
        tags: bool (B, K), skills of each trajectory.
    """

    frames: Frames
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

    def parts(self, starts: Tensor, lengths: Tensor) -> "TrajectoryBatch":
        """Returns consecutive timesteps of each trajectory, from int64 (B,) on; tags are those of the whole."""
        begins = (self.lengths.cumsum(dim=0) - self.lengths).cpu() + starts  # (B,)
        within = torch.arange(int(lengths.sum())) - (lengths.cumsum(dim=0) - lengths).repeat_interleave(lengths)
        rows = (begins.repeat_interleave(lengths) + within).to(self.lengths.device)  # (N,)
        frames = {camera: each[rows] for camera, each in self.frames.items()}
        return TrajectoryBatch(frames, self.actions[rows], lengths.to(self.lengths.device), self.tags)


def random_parts(lengths: Tensor, *, least: float, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Returns the first timestep and the length of a random part of each trajectory, int64 (B,) each.

    A part's share of its trajectory is uniform in [least, 1]; it has at least 1 timestep.
    """
    shares = least + (1 - least) * torch.rand(len(lengths), generator=generator)
    kept = (shares * lengths).ceil().long().clamp(min=1)
    starts = (torch.rand(len(lengths), generator=generator) * (lengths - kept + 1)).long()
    return starts, kept


def label_parts(labels: Tensor, starts: Tensor, lengths: Tensor) -> Tensor:
    """Returns padded labels (B, T) of parts, of those of whole trajectories."""
    parts = [row[start : start + count] for row, start, count in zip(labels, starts, lengths, strict=True)]
    return pad_sequence(parts, batch_first=True, padding_value=NO_SKILL)


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
    frames = {
        camera: torch.from_numpy(np.concatenate([arrays[item][at] for item, at in places])).to(device)
        for camera, arrays in trajectories.frames.items()
    }
    actions = [trajectories.actions[item][at] for item, at in places]
    tags = [[skill in trajectories.skills[item] for skill in spec.skills] for item in items]
    return TrajectoryBatch(
        frames,
        torch.from_numpy(np.concatenate(actions)).to(device),
        torch.tensor([len(each) for each in actions], device=device),
        torch.tensor(tags, device=device),
    )
