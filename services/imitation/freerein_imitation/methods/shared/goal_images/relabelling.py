"""Training batches of a goal-conditioned policy: slices relabelled with their last frame as goal, and frame pairs.

Encoding images dominates an update's cost, so a window of frames is encoded once and cut into many slices.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from freerein.learning.encoders import FrameTensors
from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.shared.trajectory_batches import joined, previous_actions

_SLICES_PER_WINDOW = 8
_WINDOW_MARGIN = 8
_ANCHORS_PER_TRAJECTORY = 4


@dataclass(frozen=True, eq=False)
class RelabelledSlices:
    """S slices of trajectories whose last frame is the goal; L is the most actions in one.

    Attributes:
        frames: By camera, uint8 (N, H, W, C), window after window.
        actions: Executed after each frame, float32 (N, A) or int64 (N, 1).
        previous: Executed before each frame, as `actions`; 0, or -1 when discrete, for no action.
        starts: First frame of each slice, int64 (S,).
        lengths: Actions in each slice, int64 (S,).
    """

    frames: FrameTensors
    actions: Tensor
    previous: Tensor
    starts: Tensor
    lengths: Tensor

    @property
    def goals(self) -> Tensor:
        """Goal frame of each slice, int64 (S,)."""
        return self.starts + self.lengths

    @property
    def timesteps(self) -> Tensor:
        """Frames of each slice before its goal, int64 (S, L); padded with the last."""
        return self.starts[:, None] + torch.minimum(self._time, self.lengths[:, None] - 1)

    @property
    def timesteps_to_goals(self) -> Tensor:
        """Frames of each slice up to its goal, int64 (S, L + 1); padded with the goal."""
        time = torch.arange(int(self.lengths.max()) + 1, device=self.lengths.device)
        return self.starts[:, None] + torch.minimum(time[None], self.lengths[:, None])

    @property
    def mask(self) -> Tensor:
        """Which of `timesteps` are not padding, bool (S, L)."""
        return self._time < self.lengths[:, None]

    @property
    def _time(self) -> Tensor:
        return torch.arange(int(self.lengths.max()), device=self.lengths.device)[None]


@dataclass(frozen=True, eq=False)
class RecognizerBatch:
    """N frames, all pairs of which the goal recognizer compares.

    Attributes:
        frames: By camera, uint8 (N, H, W, C).
        timesteps: Timestep of each frame, int64 (N,).
        trajectories: Trajectory of each frame, int64 (N,).
    """

    frames: FrameTensors
    timesteps: Tensor
    trajectories: Tensor

    def pairs(self, *, close_steps: int, far_steps: int) -> tuple[Tensor, Tensor, Tensor]:
        """Returns which pairs are close, far in one trajectory, and of different trajectories: bool (N, N) each.

        Pairs in between, and of a frame with itself, are none of these.
        """
        distance = (self.timesteps[:, None] - self.timesteps).abs()
        differ = self.trajectories[:, None] != self.trajectories
        itself = torch.eye(len(distance), dtype=torch.bool, device=distance.device)
        return ~differ & ~itself & (distance <= close_steps), ~differ & (distance > far_steps), differ


def sample_slices(
    trajectories: Trajectories,
    items: Sequence[int],
    rng: np.random.Generator,
    *,
    steps: tuple[int, int],
    device: torch.device,
) -> RelabelledSlices:
    """Returns random slices from a random window of each of some trajectories.

    `steps` are the fewest and the most actions in a slice; in a short trajectory a slice is as long as that allows.
    Each trajectory is at least one timestep longer than the shortest slice. `items` may repeat.
    """
    shortest, longest = steps
    windows, actions, previous, starts, lengths = [], [], [], [], []
    offset = 0
    for item in items:
        executed = trajectories.actions[item]
        size = min(longest + 1 + _WINDOW_MARGIN, len(executed))
        first = int(rng.integers(len(executed) - size + 1))
        window = slice(first, first + size)
        windows.append((item, window))
        actions.append(executed[window])
        previous.append(previous_actions(executed)[window])
        sampled = np.minimum(rng.integers(shortest, longest, _SLICES_PER_WINDOW, endpoint=True), size - 1)
        lengths.append(sampled)
        starts.append(offset + rng.integers(size - sampled))
        offset += size
    arrays = (joined(parts, device) for parts in (actions, previous, starts, lengths))
    return RelabelledSlices(trajectories.frames_at(windows, device), *arrays)


def sample_recognizer_batch(
    trajectories: Trajectories,
    items: Sequence[int],
    rng: np.random.Generator,
    *,
    close_steps: int,
    device: torch.device,
) -> RecognizerBatch:
    """Returns random frames of some trajectories, each with another one at most `close_steps` actions away."""
    places = []
    for item in items:
        last = len(trajectories.actions[item]) - 1
        anchors = rng.integers(last + 1, size=_ANCHORS_PER_TRAJECTORY)
        near = anchors + rng.integers(-close_steps, close_steps, _ANCHORS_PER_TRAJECTORY, endpoint=True)
        chosen = np.concatenate([anchors, near.clip(0, last)])
        places.append((item, chosen))
    numbers = np.repeat(np.asarray(items, np.int64), 2 * _ANCHORS_PER_TRAJECTORY)
    timesteps = joined([chosen for _, chosen in places], device)
    return RecognizerBatch(trajectories.frames_at(places, device), timesteps, torch.from_numpy(numbers).to(device))
