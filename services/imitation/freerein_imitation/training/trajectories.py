"""Trajectories to train on: frames and executed actions, without labels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.learning import trajectories as trajectory_arrays
from freerein.learning.split import train_validation_split
from freerein.learning.trajectories import TrajectoryArrays


@dataclass(frozen=True, eq=False)
class TrajectoryDataset:
    """Frames and executed actions. Frame t was observed before action t.

    Attributes:
        frames: By trajectory, uint8 (T, H, W, C).
        actions: By trajectory, float32 (T, A) in [-1, 1] or int64 (T, 1).
    """

    frames: TrajectoryArrays[np.uint8]
    actions: TrajectoryArrays[np.float32] | TrajectoryArrays[np.int64]

    def __len__(self) -> int:
        return len(self.frames)

    def lengths(self) -> npt.NDArray[np.int64]:
        """Returns the timesteps of each trajectory, int64 (n,)."""
        return np.array([len(self.actions[item]) for item in range(len(self))], np.int64)

    def subset(self, items: Sequence[int]) -> "TrajectoryDataset":
        """Returns some of the trajectories, without copying frames."""
        actions: Any = [self.actions[item] for item in items]
        return TrajectoryDataset([self.frames[item] for item in items], actions)

    def sample_frames(self, count: int) -> npt.NDArray[np.uint8]:
        """Returns about `count` frames, uint8 (N, H, W, C), spread evenly over trajectories and time."""
        return trajectory_arrays.sample_frames(self.frames, count)


def no_action(actions: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Returns the previous action before the first of `actions` (T, A): zeros, or -1 when discrete, (1, A)."""
    return np.full_like(actions[:1], -1 if np.issubdtype(actions.dtype, np.integer) else 0)


def split_trajectories(
    trajectories: TrajectoryDataset, *, fraction: float, seed: int, min_length: int
) -> tuple[TrajectoryDataset, TrajectoryDataset]:
    """Returns training and validation trajectories, at least one of each.

    Args:
        trajectories: All of them; those shorter than `min_length` timesteps are left out.
        fraction: Fraction of the trajectories for validation.
        seed: Seed of the split.
        min_length: Fewest timesteps of a trajectory.

    Raises:
        InvalidInput: Fewer than 2 are long enough.
    """
    usable = np.flatnonzero(trajectories.lengths() >= min_length)
    training, validation = train_validation_split(
        usable,
        fraction=fraction,
        seed=seed,
        unit=f"trajectories of {min_length} or more timesteps",
        hint="Record more, or longer ones: freerein sim demonstrate TASK --behaviour random --out NAME.",
    )
    return trajectories.subset(training), trajectories.subset(validation)
