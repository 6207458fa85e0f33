"""Batches of exploration, relabelled: a later frame is the goal of what was done before it.

Encoding images is what an update costs, so that a window of frames is encoded once and cut into many slices.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein_imitation.training.exploration import Exploration

_SLICES_PER_WINDOW = 8
_SLACK = 8
_GOALS_PER_TRAJECTORY = 4


@dataclass(frozen=True, eq=False)
class Slices:
    """Slices of trajectories whose last frame is the goal; L is the most actions in one.

    Attributes:
        frames: uint8 (N, H, W, C), windows one after the other.
        actions: float32 (N, A) or int64 (N, 1), executed after each frame.
        previous: As `actions`: executed before each frame; 0, or -1 where discrete, where nothing was.
        starts: int64 (S,), the frame in which each slice begins.
        lengths: int64 (S,), how many actions later its goal is seen.
    """

    frames: Tensor
    actions: Tensor
    previous: Tensor
    starts: Tensor
    lengths: Tensor

    @property
    def goals(self) -> Tensor:
        """The frame that is each slice's goal, int64 (S,)."""
        return self.starts + self.lengths

    @property
    def timesteps(self) -> Tensor:
        """The frames in which each slice acts, int64 (S, L); padded with its last."""
        return self.starts[:, None] + torch.minimum(self._time, self.lengths[:, None] - 1)

    @property
    def mask(self) -> Tensor:
        """Which of `timesteps` are not padding, bool (S, L)."""
        return self._time < self.lengths[:, None]

    @property
    def _time(self) -> Tensor:
        return torch.arange(int(self.lengths.max()), device=self.lengths.device)[None]


@dataclass(frozen=True, eq=False)
class Moments:
    """Frames to compare with one another.

    Attributes:
        frames: uint8 (N, H, W, C).
        timesteps: int64 (N,), when each was seen.
        trajectories: int64 (N,), in which trajectory.
    """

    frames: Tensor
    timesteps: Tensor
    trajectories: Tensor

    def pairs(self, *, close_steps: int, far_steps: int) -> tuple[Tensor, Tensor, Tensor]:
        """Returns which pairs are close, far apart in one trajectory, and of different ones: bool (N, N) each.

        Pairs in between, and of a frame with itself, are none of these.
        """
        apart = (self.timesteps[:, None] - self.timesteps).abs()
        elsewhere = self.trajectories[:, None] != self.trajectories
        itself = torch.eye(len(apart), dtype=torch.bool, device=apart.device)
        return ~elsewhere & ~itself & (apart <= close_steps), ~elsewhere & (apart > far_steps), elsewhere


def draw_slices(
    exploration: Exploration,
    items: Sequence[int],
    rng: np.random.Generator,
    *,
    bounds: tuple[int, int],
    device: torch.device,
) -> Slices:
    """Returns random slices from a random window of each of some trajectories.

    Args:
        exploration: Where they are; a trajectory is at least one timestep longer than the shortest slice.
        items: Which; one may come several times.
        rng: Draws windows and slices.
        bounds: Fewest and most actions in a slice; one in a short trajectory is as long as that allows.
        device: Where the tensors shall be.
    """
    shortest, longest = bounds
    frames, actions, previous, starts, lengths = [], [], [], [], []
    offset = 0
    for item in items:
        done = exploration.actions[item]
        size = min(longest + 1 + _SLACK, len(done))
        first = int(rng.integers(len(done) - size + 1))
        before = np.concatenate([_nothing_before(done), done[:-1]])
        frames.append(exploration.frames[item][first : first + size])
        actions.append(done[first : first + size])
        previous.append(before[first : first + size])
        drawn = np.minimum(rng.integers(shortest, longest, _SLICES_PER_WINDOW, endpoint=True), size - 1)
        lengths.append(drawn)
        starts.append(offset + rng.integers(size - drawn))
        offset += size
    return Slices(*(_join(parts, device) for parts in (frames, actions, previous, starts, lengths)))


def draw_moments(
    exploration: Exploration,
    items: Sequence[int],
    rng: np.random.Generator,
    *,
    close_steps: int,
    device: torch.device,
) -> Moments:
    """Returns random moments of some trajectories, each with another that is close to it.

    Args:
        exploration: Where they are.
        items: Which.
        rng: Draws the moments.
        close_steps: The most actions between close frames.
        device: Where the tensors shall be.
    """
    frames, timesteps = [], []
    for item in items:
        last = len(exploration.actions[item]) - 1
        goals = rng.integers(last + 1, size=_GOALS_PER_TRAJECTORY)
        near = goals + rng.integers(-close_steps, close_steps, _GOALS_PER_TRAJECTORY, endpoint=True)
        chosen = np.concatenate([goals, near.clip(0, last)])
        frames.append(exploration.frames[item][chosen])
        timesteps.append(chosen)
    trajectories = np.repeat(np.asarray(items, np.int64), 2 * _GOALS_PER_TRAJECTORY)
    return Moments(_join(frames, device), _join(timesteps, device), torch.from_numpy(trajectories).to(device))


def _nothing_before(actions: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.full_like(actions[:1], -1 if actions.dtype == np.int64 else 0)


def _join(parts: Sequence[npt.NDArray[Any]], device: torch.device) -> Tensor:
    return torch.from_numpy(np.concatenate(parts)).to(device)
