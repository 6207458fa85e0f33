"""Trajectories as learners read them: frames, executed actions and tags; never labels of timesteps."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.data.batch_memory import MOST_NUMBERS
from freerein.errors import InvalidInput
from freerein.learning.split import train_validation_split

D_co = TypeVar("D_co", bound=np.generic, covariant=True)


class TrajectoryArrays(Protocol[D_co]):
    """One array (T, ...) per trajectory: a list of arrays, or `freerein.data.cache.StepCache`."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> npt.NDArray[D_co]: ...


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Frames and executed actions of n trajectories, and what else a learner may see of each.

    Attributes:
        frames: By camera and trajectory, uint8 (T, H, W, C); frame t was observed before action t.
        actions: By trajectory, float32 (T, A) in [-1, 1] or int64 (T, 1).
        skills: The set of skills of each trajectory; empty where unknown.
        goal_texts: Goal text of each trajectory; empty where unknown.
        reached: By trajectory, bool (T,), which frames show its goal, as a reward model judges; empty where unknown.
        terminated: By trajectory, bool (T,), whether the episode terminated after each action; empty where unknown.

    Raises:
        InvalidInput: There are no trajectories, one is empty, or arrays differ in their lengths.
    """

    frames: Mapping[str, TrajectoryArrays[np.uint8]]
    actions: TrajectoryArrays[np.float32] | TrajectoryArrays[np.int64]
    skills: Sequence[tuple[str, ...]] = ()
    goal_texts: Sequence[str] = ()
    reached: Sequence[npt.NDArray[np.bool_]] = ()
    terminated: TrajectoryArrays[np.bool_] | tuple[()] = ()

    def __post_init__(self) -> None:
        arrays = [*self.frames.values(), self.actions, *([self.terminated] if len(self.terminated) else [])]
        counts = {len(each) for each in (*arrays, *filter(None, (self.skills, self.goal_texts, self.reached)))}
        if len(counts) != 1 or 0 in counts or not self.frames:
            raise InvalidInput(
                f"Frames, actions and tags must be of the same trajectories, 1 or more; got {sorted(counts)}."
            )
        for item in range(len(self)):
            lengths = {len(each[item]) for each in arrays}
            if len(lengths) != 1 or 0 in lengths:
                raise InvalidInput(
                    f"Trajectory {item} must have as many frames as actions, at least 1; got {sorted(lengths)}.",
                    field="dataset",
                    hint="Remove it from the dataset, or record it again.",
                )

    def __len__(self) -> int:
        return len(self.actions)

    def lengths(self) -> npt.NDArray[np.int64]:
        """Returns the timesteps of each trajectory, int64 (n,)."""
        return np.array([len(self.actions[item]) for item in range(len(self))], np.int64)

    def windows(self, steps: int) -> npt.NDArray[np.int64]:
        """Returns the trajectory of each window of an epoch, int64 (n,), so that every timestep counts about alike."""
        counts = np.ceil(self.lengths() / steps).astype(np.int64)
        return np.repeat(np.arange(len(counts)), counts)

    def subset(self, items: Sequence[int]) -> "Trajectories":
        """Returns some of the trajectories, without copying frames."""
        chosen: dict[str, Any] = {
            "actions": [self.actions[item] for item in items],
            "skills": [self.skills[item] for item in items] if self.skills else (),
            "goal_texts": [self.goal_texts[item] for item in items] if self.goal_texts else (),
            "reached": [self.reached[item] for item in items] if self.reached else (),
            "terminated": [self.terminated[item] for item in items] if len(self.terminated) else (),
        }
        frames = {camera: [each[item] for item in items] for camera, each in self.frames.items()}
        return replace(self, frames=frames, **chosen)

    def split(self, *, fraction: float, seed: int, min_length: int = 1) -> tuple["Trajectories", "Trajectories"]:
        """Returns the training and the validation trajectories; see `train_validation_split`.

        Trajectories of fewer than `min_length` timesteps are left out.
        """
        usable = np.flatnonzero(self.lengths() >= min_length)
        training, validation = train_validation_split(
            usable,
            fraction=fraction,
            seed=seed,
            unit="trajectories" if min_length == 1 else f"trajectories of {min_length} or more timesteps",
            hint="Record more, or longer ones: freerein sim demonstrate TASK --out NAME.",
        )
        return self.subset(training), self.subset(validation)

    def frames_at(
        self, places: Sequence[tuple[int, slice | npt.NDArray[np.int64]]], device: torch.device
    ) -> dict[str, Tensor]:
        """Returns the frames of each camera, uint8 (N, H, W, C), at some timesteps of some trajectories."""
        return {
            camera: torch.from_numpy(np.concatenate([arrays[item][at] for item, at in places])).to(device)
            for camera, arrays in self.frames.items()
        }

    def sample_frames(self, count: int) -> dict[str, Tensor]:
        """Returns about `count` frames of each camera, uint8 (N, H, W, C), spaced evenly over all trajectories.

        They are fewer where they would be more than `MOST_NUMBERS` numbers.
        """
        total, largest = int(self.lengths().sum()), max(math.prod(each[0].shape[1:]) for each in self.frames.values())
        every = max(1, total // count, -(-total * largest // MOST_NUMBERS))
        return {
            camera: torch.from_numpy(np.concatenate([each[item][item % every :: every] for item in range(len(self))]))
            for camera, each in self.frames.items()
        }
