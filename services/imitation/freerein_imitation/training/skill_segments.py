"""Training data of skill policies: segments of demonstrations with one predicted skill label."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from freerein.errors import InvalidInput
from freerein.learning.encoders import Frames
from freerein.learning.split import train_validation_split
from freerein.learning.trajectories import Trajectories
from freerein_imitation.training.previous_actions import previous_actions


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
        trajectories: The demonstrations.
        features: By trajectory, image features of each frame, float32 (T, D); None where the encoder is trained, so
            that batches hold frames.
    """

    segments: Sequence[SkillSegment]
    trajectories: Trajectories
    features: Mapping[int, Tensor] | None = None

    def __len__(self) -> int:
        return len(self.segments)

    def lengths(self) -> npt.NDArray[np.int64]:
        """Returns the timesteps of each segment, int64 (n,)."""
        return np.array([each.stop - each.start for each in self.segments], np.int64)

    @property
    def shown(self) -> list[int]:
        """Trajectories that the segments are of, ascending."""
        return sorted({each.trajectory for each in self.segments})

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
        images: Features of N observed timesteps, float32 (N, D), or their frames by camera, uint8 (N, H, W, C);
            segment after segment, without padding.
        lengths: Observed timesteps of each segment, with sum N.
        skills: Indices of skills, int64 (B,).
        previous: Executed before each timestep, float32 (B, T, A), or int64 (B, T, 1) with -1 for no action.
        actions: Executed after it, as `previous`.
        inside: Timesteps of the segment, bool (B, T).
        terminates: Timesteps in which the skill terminates, bool (B, T).
    """

    images: Tensor | Frames
    lengths: list[int]
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
    places = [
        (each.trajectory, slice(start, each.stop + steps_after)) for each, start in zip(segments, starts, strict=True)
    ]
    actions = [torch.tensor(dataset.trajectories.actions[item][at]) for item, at in places]
    previous = [torch.tensor(previous_actions(dataset.trajectories.actions[item])[at]) for item, at in places]
    lengths = [len(each) for each in actions]
    time = torch.arange(max(lengths))
    observed = time < torch.tensor(lengths)[:, None]  # (B, T)
    left = torch.tensor([each.stop - start for each, start in zip(segments, starts, strict=True)])[:, None]  # (B, 1)
    return SegmentBatch(
        images=_images(dataset, places, device),
        lengths=lengths,
        skills=torch.tensor([each.skill for each in segments], device=device),
        previous=pad_sequence(previous, batch_first=True).to(device),
        actions=pad_sequence(actions, batch_first=True).to(device),
        inside=(observed & (time < left)).to(device),
        terminates=(observed & (time >= left - 1)).to(device),
    )


def _images(dataset: SegmentDataset, places: Sequence[tuple[int, slice]], device: torch.device) -> Tensor | Frames:
    """Returns the images of some timesteps as a batch holds them."""
    if dataset.features is not None:
        return torch.cat([dataset.features[item][at] for item, at in places]).to(device)
    return {
        camera: torch.from_numpy(np.concatenate([arrays[item][at] for item, at in places])).to(device)
        for camera, arrays in dataset.trajectories.frames.items()
    }
