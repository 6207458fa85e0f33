"""What skills are cloned from: segments of demonstrations in which one skill is executed, as predicted labels say."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from freerein.errors import InvalidInput
from freerein.learning.split import train_validation_split
from freerein_imitation.model.codebook import ColourCodebook
from freerein_imitation.training.exploration import Trajectories

_FRAMES_AT_ONCE = 256


@dataclass(frozen=True)
class Segment:
    """Some timesteps of one trajectory in which one skill is executed.

    Attributes:
        trajectory: Which one.
        start: Its first timestep.
        stop: The one after its last.
        skill: Index of the skill.
    """

    trajectory: int
    start: int
    stop: int
    skill: int


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments to learn from, and the demonstrations that they are parts of.

    Attributes:
        items: The segments.
        places: By trajectory, where each colour is in each frame, float32 (T, colours, MOMENTS).
        actions: By trajectory, float32 (T, A) in [-1, 1] or int64 (T, 1); frame t was seen before action t.
    """

    items: Sequence[Segment]
    places: Sequence[Tensor]
    actions: Trajectories[np.float32] | Trajectories[np.int64]

    def __len__(self) -> int:
        return len(self.items)

    def lengths(self) -> npt.NDArray[np.int64]:
        """Returns the timesteps of each segment, int64 (n,)."""
        return np.array([item.stop - item.start for item in self.items], np.int64)


def cut(labels: Sequence[npt.NDArray[np.int64]], *, shortest: int) -> list[Segment]:
    """Returns the segments of trajectories: the longest runs of one label, but for those that are too short.

    Args:
        labels: By trajectory, the skill at each timestep, int64 (T,).
        shortest: Fewest timesteps of a segment.
    """
    found = []
    for trajectory, each in enumerate(labels):
        bounds = [0, *(np.flatnonzero(np.diff(each)) + 1).tolist(), len(each)]
        found += [
            Segment(trajectory, start, stop, int(each[start]))
            for start, stop in pairwise(bounds)
            if stop - start >= shortest
        ]
    return found


def hold_out(segments: Segments, *, share: float, seed: int) -> tuple[Segments, Segments]:
    """Returns the segments to learn from and those held out: all of a random `share` of the trajectories.

    Raises:
        InvalidInput: There are segments of fewer than 2 trajectories.
    """
    trajectories = sorted({item.trajectory for item in segments.items})
    if len(trajectories) < 2:
        raise InvalidInput(
            f"A fit needs segments of at least 2 trajectories, one of them to hold out; got {len(trajectories)}.",
            field="dataset",
            hint="Record more demonstrations, and label them.",
        )
    sides = [set(side) for side in train_validation_split(trajectories, fraction=share, seed=seed)]
    parts = [[item for item in segments.items if item.trajectory in side] for side in sides]
    training, validation = (Segments(part, segments.places, segments.actions) for part in parts)
    return training, validation


@torch.no_grad()
def see(codebook: ColourCodebook, frames: Trajectories[np.uint8]) -> list[Tensor]:
    """Returns what a codebook sees in trajectories of frames: float32 (T, colours, MOMENTS) each, on the CPU."""
    return [
        torch.cat(
            [
                codebook(torch.tensor(frames[item][start : start + _FRAMES_AT_ONCE]))
                for start in range(0, len(frames[item]), _FRAMES_AT_ONCE)
            ]
        )
        for item in range(len(frames))
    ]


@dataclass(frozen=True, eq=False)
class Batch:
    """Some segments, padded to the longest, with some timesteps after each.

    Attributes:
        places: Where each colour is, float32 (B, T, colours, MOMENTS).
        skills: Indices, int64 (B,).
        previous: Executed before each timestep, float32 (B, T, A), or int64 (B, T, 1) with -1 for none.
        actions: Executed after it, as `previous`.
        inside: Timesteps of the segment, bool (B, T).
        seen: These and those after it, bool (B, T).
        ends: Timesteps in which the end head is to fire, bool (B, T).
    """

    places: Tensor
    skills: Tensor
    previous: Tensor
    actions: Tensor
    inside: Tensor
    seen: Tensor
    ends: Tensor


def gather(
    segments: Segments, items: Sequence[Segment], starts: Sequence[int], *, after: int, device: torch.device
) -> Batch:
    """Returns segments as tensors on a device.

    Args:
        segments: Where they are from.
        items: Which.
        starts: The timestep at which each is entered, no matter where it is said to begin.
        after: Timesteps after each segment to show to the end head, where the trajectory has them.
        device: Where to.
    """
    parts = [_part(segments, item, start, after) for item, start in zip(items, starts, strict=True)]
    places, previous, actions, times, stops = zip(*parts, strict=True)
    seen = pad_sequence([torch.ones(len(each), dtype=torch.bool) for each in times], batch_first=True)  # (B, T)
    time = pad_sequence(list(times), batch_first=True)  # (B, T)
    stop = torch.tensor(stops)[:, None]
    batch = Batch(
        places=pad_sequence(list(places), batch_first=True),
        skills=torch.tensor([item.skill for item in items]),
        previous=pad_sequence(list(previous), batch_first=True),
        actions=pad_sequence(list(actions), batch_first=True),
        inside=seen & (time < stop),
        seen=seen,
        ends=seen & (time >= stop - 1),
    )
    return Batch(**{name: tensor.to(device) for name, tensor in vars(batch).items()})


def _part(segments: Segments, item: Segment, start: int, after: int) -> tuple[Tensor, Tensor, Tensor, Tensor, int]:
    """Returns what is seen, was executed and is executed at the timesteps of one segment, and which these are."""
    actions: Any = segments.actions[item.trajectory]
    stop = min(item.stop + after, len(actions))
    executed = actions[start:stop]
    none = np.full_like(actions[:1], -1 if np.issubdtype(actions.dtype, np.integer) else 0)
    previous = np.concatenate([actions[start - 1 : start] if start else none, executed[:-1]])
    time = torch.arange(start, stop)
    return segments.places[item.trajectory][start:stop], torch.tensor(previous), torch.tensor(executed), time, item.stop
