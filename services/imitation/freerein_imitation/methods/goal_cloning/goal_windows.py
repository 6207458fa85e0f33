"""Training batches of goal-conditioned cloning: windows of trajectories, frames that look alike, and pairs of both.

Encoding images dominates an update's cost, so each frame is encoded once and takes part in many pairs.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning.encoders import FrameTensors
from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.shared.trajectory_batches import joined, previous_actions

Places = npt.NDArray[np.int64]
"""int64 (...), frames of a batch, or timesteps of a trajectory."""

_WINDOW_MARGIN = 9
_COMPARED = 12  # frames of a window's trajectory beside the window
_ALIKE_SHARE = 0.7
_ALIKE = 4
_COMPARED_AT_ONCE = 512  # timesteps with all others
_GOALS_PER_WINDOW = 48
_CHANGES_PER_WINDOW = 40
_FIRST_SHARE = 0.15  # of observations without one before, as at the start of a goal
_TIE_BREAK = 0.2  # in tolerances
_LEAST_CLOSE_STEPS_IN_WINDOW = 4  # sooner, fingers have hardly moved, and tell that little time has passed


@dataclass(frozen=True, eq=False)
class GoalWindows:
    """N frames of B windows: each window's own timesteps in order, then others of its trajectory.

    Attributes:
        frames: By camera, uint8 (N, H, W, C).
        timesteps: Of each frame in its trajectory, int64 (N,).
        trajectories: Trajectory of each frame, int64 (N,).
        actions: Executed after each frame, float32 (N, A) or int64 (N, 1).
        previous: Executed before each frame, as `actions`; 0, or -1 when discrete, for none.
        odometer: Sum of the actions executed before each frame, float32 (N, A).
        windows: First frame, and number of own timesteps, of each window: int64 (B, 2).
    """

    frames: FrameTensors
    timesteps: Places
    trajectories: Places
    actions: Tensor
    previous: Tensor
    odometer: Tensor
    windows: Places


@dataclass(frozen=True, eq=False)
class GoalPairs:
    """P pairs of observation and goal, as frames of a batch: int64 (P,) each.

    Attributes:
        observations: Observations.
        goals: Their goals, later in the same window.
        before: The observation one step earlier, or the same one for none.
    """

    observations: Places
    goals: Places
    before: Places


@dataclass(frozen=True, eq=False)
class ChangePairs:
    """P pairs of frames of a batch.

    Attributes:
        first: int64 (P,).
        second: int64 (P,).
        is_close: Whether they are close in time: bool (P,).
        is_far: Whether they are far in time, rather than close or of different trajectories: bool (P,).
    """

    first: Places
    second: Places
    is_close: npt.NDArray[np.bool_]
    is_far: npt.NDArray[np.bool_]


def window_steps(max_goal_steps: int) -> int:
    """Returns the most timesteps of a window."""
    return max_goal_steps + _WINDOW_MARGIN


def lookalikes(statistics: Tensor, *, far_steps: int) -> Places:
    """Returns timesteps that look most like each one, of those far from it in time: int64 (T, 4).

    `statistics` are the image statistics of a trajectory's frames, float32 (T, D).
    """
    time = torch.arange(len(statistics), device=statistics.device)
    nearest = []
    for rows in time.tensor_split(math.ceil(len(time) / _COMPARED_AT_ONCE)):  # equal parts: few rows round differently
        near = (time[rows, None] - time).abs() < far_steps  # (R, T)
        distance = torch.cdist(statistics[rows], statistics).masked_fill_(near, torch.inf)
        nearest.append(distance.argsort(dim=1)[:, :_ALIKE].clone())  # topk would choose others among equals
    return np.asarray(torch.cat(nearest).cpu().numpy(), np.int64)


def sample_windows(
    trajectories: Trajectories,
    alike: Sequence[Places],
    items: Sequence[int],
    rng: np.random.Generator,
    *,
    max_goal_steps: int,
    device: torch.device,
) -> GoalWindows:
    """Returns a random window of each of some trajectories, `items`, which may repeat.

    `alike` are the lookalikes of each trajectory's timesteps.
    """
    places, windows, offset = [], [], 0
    for item in items:
        length = len(trajectories.actions[item])
        own = min(window_steps(max_goal_steps), length)
        start = int(rng.integers(length - own + 1))
        anchors = rng.integers(start, start + own, _COMPARED)
        found = alike[item][anchors, rng.integers(alike[item].shape[1], size=_COMPARED)]
        others = np.where(rng.random(_COMPARED) < _ALIKE_SHARE, found, rng.integers(length, size=_COMPARED))
        places.append((item, np.concatenate([np.arange(start, start + own), others])))
        windows.append((offset, own))
        offset += own + _COMPARED
    executed = [np.asarray(trajectories.actions[item]) for item, _ in places]
    odometers = [np.cumsum(each, axis=0, dtype=np.float32) - each.astype(np.float32) for each in executed]
    return GoalWindows(
        frames=trajectories.frames_at(places, device),
        timesteps=np.concatenate([at for _, at in places]),
        trajectories=np.repeat([item for item, _ in places], [len(at) for _, at in places]),
        actions=joined([each[at] for each, (_, at) in zip(executed, places, strict=True)], device),
        previous=joined([previous_actions(each)[at] for each, (_, at) in zip(executed, places, strict=True)], device),
        odometer=joined([each[at] for each, (_, at) in zip(odometers, places, strict=True)], device).float(),
        windows=np.array(windows, np.int64),
    )


def sample_goal_pairs(batch: GoalWindows, rng: np.random.Generator, *, max_goal_steps: int) -> GoalPairs:
    """Returns random observations with goals up to `max_goal_steps` actions ahead."""
    first, own = batch.windows.repeat(_GOALS_PER_WINDOW, axis=0).T
    at = rng.integers(own - 1)
    goals = np.minimum(at + rng.integers(1, max_goal_steps, len(at), endpoint=True), own - 1)
    has_before = (at > 0) & (rng.random(len(at)) >= _FIRST_SHARE)
    return GoalPairs(first + at, first + goals, first + at - has_before)


def sample_change_pairs(
    batch: GoalWindows, places: npt.NDArray[np.float32], rng: np.random.Generator, *, close_steps: int, far_steps: int
) -> ChangePairs:
    """Returns pairs at nearby places: close in time, and as far apart of different trajectories, and far in time.

    Pairs of all kinds are alike in how far apart their places are, so that places tell nothing about which kind it is.
    `places` of the frames, float32 (N, A), are in units of the largest distance of nearby ones. `close_steps` and
    `far_steps` are the most and the fewest actions between frames that are close and far in time.
    """
    anchors = np.concatenate([rng.integers(at, at + own, _CHANGES_PER_WINDOW) for at, own in batch.windows.tolist()])
    is_own = batch.trajectories[anchors][:, None] == batch.trajectories  # (P, N)
    steps = np.abs(batch.timesteps[anchors][:, None] - batch.timesteps)
    apart = np.abs(places[anchors][:, None] - places).max(axis=2)
    is_close = (
        is_own & (steps >= min(_LEAST_CLOSE_STEPS_IN_WINDOW, close_steps)) & (steps <= close_steps) & (apart <= 1)
    )
    usable = is_close.any(axis=1)
    anchors, is_own, steps, apart, is_close = (each[usable] for each in (anchors, is_own, steps, apart, is_close))
    close = np.where(is_close, rng.random(apart.shape), np.inf).argmin(axis=1)
    unlike = np.abs(apart - np.take_along_axis(apart, close[:, None], axis=1)) + _TIE_BREAK * rng.random(apart.shape)
    kinds = is_close, ~is_own, is_own & (steps >= far_steps)
    partners = [close, *(np.where(kind, unlike, np.inf).argmin(axis=1) for kind in kinds[1:])]
    exists = [kind.any(axis=1) for kind in kinds]
    counts = [int(each.sum()) for each in exists]
    return ChangePairs(
        first=np.concatenate([anchors[each] for each in exists]),
        second=np.concatenate([partner[each] for partner, each in zip(partners, exists, strict=True)]),
        is_close=np.repeat([True, False, False], counts),
        is_far=np.repeat([False, False, True], counts),
    )
