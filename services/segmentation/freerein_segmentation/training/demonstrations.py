"""What the learner sees of demonstrations; labels of timesteps have no way in."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning.split import train_validation_split
from freerein_segmentation.model import ModelSpec

D_co = TypeVar("D_co", bound=np.generic, covariant=True)


class Trajectories(Protocol[D_co]):
    """One array (T, ...) per trajectory: a list of arrays, or `freerein.data.cache.StepCache`."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> npt.NDArray[D_co]: ...


@dataclass(frozen=True, eq=False)
class Demonstrations:
    """Frames, executed actions, and the set of skills of each trajectory.

    Attributes:
        frames: By trajectory, uint8 (T, H, W, C).
        actions: By trajectory, float32 (T, A) in [-1, 1] or int64 (T, 1).
        skills: By trajectory, the set of skills that occur, at least one.

    Raises:
        InvalidInput: The three do not belong together, or a trajectory has no tags.
    """

    frames: Trajectories[np.uint8]
    actions: Trajectories[np.float32] | Trajectories[np.int64]
    skills: Sequence[tuple[str, ...]]

    def __post_init__(self) -> None:
        counts = len(self.frames), len(self.actions), len(self.skills)
        if len(set(counts)) > 1 or counts[0] == 0:
            raise InvalidInput(f"Frames, actions and skills must be of as many trajectories, at least 1; got {counts}.")
        for index in range(counts[0]):
            timesteps = len(self.frames[index]), len(self.actions[index])
            if timesteps[0] != timesteps[1] or timesteps[0] == 0 or not self.skills[index]:
                raise InvalidInput(
                    f"Trajectory {index} must have as many frames as actions, at least 1, and a skill; "
                    f"got {timesteps[0]}, {timesteps[1]} and {len(self.skills[index])} skills.",
                    hint="Leave it out of the dataset, or tag it with the skills that occur in it.",
                )

    def __len__(self) -> int:
        return len(self.frames)

    def subset(self, items: Sequence[int]) -> "Demonstrations":
        """Returns some of the trajectories, without copying a frame."""
        actions: Any = [self.actions[item] for item in items]
        return Demonstrations([self.frames[item] for item in items], actions, [self.skills[item] for item in items])


def hold_out(demonstrations: Demonstrations, *, share: float, seed: int) -> tuple[Demonstrations, Demonstrations]:
    """Returns the trajectories to learn from and those held out, a random `share`, at least one of each.

    Raises:
        InvalidInput: There is only one.
    """
    if len(demonstrations) < 2:
        raise InvalidInput("A fit needs at least 2 trajectories, one of them to hold out; got 1.")
    learnt, held_out = train_validation_split(np.arange(len(demonstrations)), fraction=share, seed=seed)
    return demonstrations.subset(learnt), demonstrations.subset(held_out)


@dataclass(frozen=True, eq=False)
class Batch:
    """Some trajectories, one after the other.

    Attributes:
        frames: uint8 (N, H, W, C).
        actions: float32 (N, A) or int64 (N, 1).
        lengths: int64 (B,), the timesteps of each trajectory, N together.
        tags: bool (B, K), the skills of each trajectory.
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
) -> Batch:
    """Returns some trajectories, every `spec.stride`-th timestep of each, as tensors on a device.

    Args:
        demonstrations: Where they are.
        items: Which.
        phases: The first timestep of each; taken modulo its length where it is shorter than the stride.
        spec: The network that they are for.
        device: Where it is.
    """
    frames, actions = [], []
    for item, phase in zip(items, phases, strict=True):
        seen, done = demonstrations.frames[item], demonstrations.actions[item]
        frames.append(seen[phase % len(seen) :: spec.stride])
        actions.append(done[phase % len(seen) :: spec.stride])
    tags = [[skill in demonstrations.skills[item] for skill in spec.skills] for item in items]
    return Batch(
        torch.from_numpy(np.concatenate(frames)).to(device),
        torch.from_numpy(np.concatenate(actions)).to(device),
        torch.tensor([len(each) for each in frames], device=device),
        torch.tensor(tags, device=device),
    )
