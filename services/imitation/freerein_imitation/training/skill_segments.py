"""Training data of skill policies: segments of demonstrations with one predicted skill label."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from freerein.errors import InvalidInput
from freerein.learning.split import train_validation_split
from freerein.learning.trajectories import TrajectoryArrays
from freerein_imitation.training.trajectories import no_action


@dataclass(frozen=True)
class SkillSegment:
    """Consecutive timesteps of one trajectory with one skill label.

    Attributes:
        trajectory: Index of the trajectory.
        start: First timestep.
        stop: Timestep after the last.
        skill: Index of the skill.
    """

    trajectory: int
    start: int
    stop: int
    skill: int


@dataclass(frozen=True, eq=False)
class SegmentDataset:
    """Segments, and the demonstrations that they are parts of.

    Attributes:
        segments: The segments.
        moments: By trajectory, colour moments of each frame, float32 (T, colours, MOMENTS).
        actions: By trajectory, float32 (T, A) in [-1, 1] or int64 (T, 1); frame t was observed before action t.
    """

    segments: Sequence[SkillSegment]
    moments: Sequence[Tensor]
    actions: TrajectoryArrays[np.float32] | TrajectoryArrays[np.int64]

    def __len__(self) -> int:
        return len(self.segments)

    def lengths(self) -> npt.NDArray[np.int64]:
        """Returns the timesteps of each segment, int64 (n,)."""
        return np.array([each.stop - each.start for each in self.segments], np.int64)

    def only(self, skills: Sequence[int]) -> "SegmentDataset":
        """Returns the segments of some skills, relabelled by their indices in `skills`."""
        kept = [replace(each, skill=skills.index(each.skill)) for each in self.segments if each.skill in skills]
        return replace(self, segments=kept)


def find_segments(labels: Sequence[npt.NDArray[np.int64]], *, min_steps: int) -> list[SkillSegment]:
    """Returns the runs of equal labels that are long enough.

    Args:
        labels: By trajectory, the skill at each timestep, int64 (T,).
        min_steps: Fewest timesteps of a segment.
    """
    found = []
    for trajectory, each in enumerate(labels):
        bounds = [0, *(np.flatnonzero(np.diff(each)) + 1).tolist(), len(each)]
        found += [
            SkillSegment(trajectory, start, stop, int(each[start]))
            for start, stop in pairwise(bounds)
            if stop - start >= min_steps
        ]
    return found


def split_segments(dataset: SegmentDataset, *, fraction: float, seed: int) -> tuple[SegmentDataset, SegmentDataset]:
    """Returns training and validation segments; `fraction` of the trajectories are for validation.

    Raises:
        InvalidInput: The segments are of fewer than 2 trajectories.
    """
    trajectories = sorted({each.trajectory for each in dataset.segments})
    if len(trajectories) < 2:
        raise InvalidInput(
            f"A fit needs segments of at least 2 trajectories, one of them for validation; got {len(trajectories)}.",
            field="dataset",
            hint="Record more demonstrations, and label them.",
        )
    sides = [set(side) for side in train_validation_split(trajectories, fraction=fraction, seed=seed)]
    training, validation = (
        replace(dataset, segments=[each for each in dataset.segments if each.trajectory in side]) for side in sides
    )
    return training, validation


@dataclass(frozen=True, eq=False)
class SegmentBatch:
    """Segments, padded to the longest, each with some timesteps after its end.

    Attributes:
        moments: Colour moments, float32 (B, T, colours, MOMENTS).
        skills: Indices of skills, int64 (B,).
        previous: Executed before each timestep, float32 (B, T, A), or int64 (B, T, 1) with -1 for no action.
        actions: Executed after it, as `previous`.
        inside: Timesteps of the segment, bool (B, T).
        terminates: Timesteps in which the skill terminates, bool (B, T).
    """

    moments: Tensor
    skills: Tensor
    previous: Tensor
    actions: Tensor
    inside: Tensor
    terminates: Tensor


def collate(
    dataset: SegmentDataset,
    segments: Sequence[SkillSegment],
    starts: Sequence[int],
    *,
    steps_after: int,
    device: torch.device,
) -> SegmentBatch:
    """Returns a batch of segments.

    Args:
        dataset: Dataset of the segments.
        segments: Segments of the batch.
        starts: First timestep of each in the batch, which may differ from its labelled start.
        steps_after: Timesteps after each segment, where the trajectory has them.
        device: Device of the tensors.
    """
    parts = [_slice(dataset, each, start, steps_after) for each, start in zip(segments, starts, strict=True)]
    moments, previous, actions, times = (
        pad_sequence(list(each), batch_first=True) for each in zip(*parts, strict=True)
    )
    lengths = torch.tensor([len(part[-1]) for part in parts])
    observed = torch.arange(times.shape[1]) < lengths[:, None]  # (B, T)
    stop = torch.tensor([each.stop for each in segments])[:, None]
    batch = SegmentBatch(
        moments=moments,
        skills=torch.tensor([each.skill for each in segments]),
        previous=previous,
        actions=actions,
        inside=observed & (times < stop),
        terminates=observed & (times >= stop - 1),
    )
    return SegmentBatch(**{name: tensor.to(device) for name, tensor in vars(batch).items()})


def _slice(dataset: SegmentDataset, segment: SkillSegment, start: int, steps_after: int) -> tuple[Tensor, ...]:
    """Returns moments, previous actions, actions and timesteps of one segment."""
    actions: Any = dataset.actions[segment.trajectory]
    stop = min(segment.stop + steps_after, len(actions))
    executed = actions[start:stop]
    previous = np.concatenate([actions[start - 1 : start] if start else no_action(actions), executed[:-1]])
    moments = dataset.moments[segment.trajectory][start:stop]
    return moments, torch.tensor(previous), torch.tensor(executed), torch.arange(start, stop)
