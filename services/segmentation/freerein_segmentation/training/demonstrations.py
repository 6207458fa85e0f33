"""Training data: frames, actions and tags of demonstrations; there are no labels of timesteps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning.split import train_validation_split
from freerein.learning.trajectories import TrajectoryArrays
from freerein_segmentation.model import ModelSpec


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Frames, executed actions and tags of each trajectory.

    Attributes:
        frames: uint8 (T, H, W, C) per trajectory.
        actions: float32 (T, A) in [-1, 1] or int64 (T, 1) per trajectory.
        skills: The set of skills of each trajectory, at least one.

    Raises:
        InvalidInput: The lengths differ, or a trajectory has no tags.
    """

    frames: TrajectoryArrays[np.uint8]
    actions: TrajectoryArrays[np.float32] | TrajectoryArrays[np.int64]
    skills: Sequence[tuple[str, ...]]

    def __post_init__(self) -> None:
        counts = len(self.frames), len(self.actions), len(self.skills)
        if len(set(counts)) > 1 or counts[0] == 0:
            raise InvalidInput(f"Frames, actions, skills must cover the same trajectories, 1 or more; got {counts}.")
        for index in range(counts[0]):
            timesteps = len(self.frames[index]), len(self.actions[index])
            if timesteps[0] != timesteps[1] or timesteps[0] == 0 or not self.skills[index]:
                raise InvalidInput(
                    f"Trajectory {index} must have as many frames as actions, at least 1, and a skill; "
                    f"got {timesteps[0]}, {timesteps[1]} and {len(self.skills[index])} skills.",
                    hint="Remove it from the dataset, or tag it with the skills that occur in it.",
                )

    def __len__(self) -> int:
        return len(self.frames)

    def subset(self, items: Sequence[int]) -> "Demonstrations":
        """Returns a subset of the trajectories, without copying frames."""
        actions: Any = [self.actions[item] for item in items]
        return Demonstrations([self.frames[item] for item in items], actions, [self.skills[item] for item in items])

    def split(self, *, fraction: float, seed: int) -> tuple["Demonstrations", "Demonstrations"]:
        """Returns the training and the validation trajectories; see `train_validation_split`."""
        training, validation = train_validation_split(range(len(self)), fraction=fraction, seed=seed)
        return self.subset(training), self.subset(validation)


@dataclass(frozen=True, eq=False)
class TrajectoryBatch:
    """Concatenated trajectories.

    Attributes:
        frames: uint8 (N, H, W, C).
        actions: float32 (N, A) or int64 (N, 1).
        lengths: int64 (B,), timesteps of each trajectory, with sum N.
        tags: bool (B, K), skills of each trajectory.
    """

    frames: Tensor
    actions: Tensor
    lengths: Tensor
    tags: Tensor


def gather(
    demonstrations: Demonstrations,
    items: Sequence[int],
    phases: Sequence[int],
    *,
    spec: ModelSpec,
    device: torch.device,
) -> TrajectoryBatch:
    """Returns every `spec.stride`-th timestep of some trajectories, as tensors on a device.

    `phases` are the first timestep of each, modulo its length.
    """
    frames, actions = [], []
    for item, phase in zip(items, phases, strict=True):
        timesteps = slice(phase % len(demonstrations.frames[item]), None, spec.stride)
        frames.append(demonstrations.frames[item][timesteps])
        actions.append(demonstrations.actions[item][timesteps])
    tags = [[skill in demonstrations.skills[item] for skill in spec.skills] for item in items]
    return TrajectoryBatch(
        torch.from_numpy(np.concatenate(frames)).to(device),
        torch.from_numpy(np.concatenate(actions)).to(device),
        torch.tensor([len(each) for each in frames], device=device),
        torch.tensor(tags, device=device),
    )
