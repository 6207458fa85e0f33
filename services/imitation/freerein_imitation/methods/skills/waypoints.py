"""Waypoints of a demonstrated skill, and the times of its grasp and its release, from executed actions alone.

Waypoints are those of automatic waypoint extraction (Shi et al., 2023): the fewest between which straight lines stay
near the path. They tell where to go without the noise, speed and pauses of a demonstration.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

_PIECE_COST = 0.8  # deviation, in actions summed over timesteps, that one more waypoint must save
_LONGEST_PIECE = 64
_NEAR = 0.25  # actions; a waypoint that near is passed, or policies would rest where demonstrations wait
_ACTING = 0.5
"""Least speed of a gripper that opens or closes; noise and small corrections are slower."""

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Waypoints of a trajectory of T timesteps.

    Attributes:
        upcoming: By timestep, when the next waypoint is reached: before that action, or T; int64 (T,).
        displacement: From before each action to the next waypoint, float32 (T, A).
    """

    upcoming: npt.NDArray[np.int64]
    displacement: npt.NDArray[np.float32]

    @classmethod
    def of(cls, actions: npt.NDArray[np.float32]) -> "Waypoints":
        """Returns the waypoints of executed actions (T, A)."""
        path = np.concatenate([np.zeros((1, actions.shape[1])), np.cumsum(actions, axis=0, dtype=np.float64)])
        found, upcoming = find_waypoints(path), np.zeros(len(actions), np.int64)
        for timestep in range(len(actions)):
            ahead = found[found > timestep]
            is_far = np.abs(path[ahead] - path[timestep]).max(axis=1) > _NEAR
            upcoming[timestep] = ahead[is_far.argmax() if is_far.any() else -1]
        return cls(upcoming, np.asarray(path[upcoming] - path[:-1], np.float32))


def find_waypoints(path: Floats) -> npt.NDArray[np.int64]:
    """Returns the indices of the waypoints of a path (n, D), n at least 2, with its first and last point, ascending."""
    count = len(path)
    costs, before = np.full(count, np.inf), np.zeros(count, np.int64)
    costs[0] = 0.0
    for start in range(count - 1):
        stop = min(count, start + 1 + _LONGEST_PIECE)
        reached = costs[start] + _PIECE_COST + _deviations(path[start + 1 : stop] - path[start])
        better = np.flatnonzero(reached < costs[start + 1 : stop])
        costs[start + 1 + better], before[start + 1 + better] = reached[better], start
    found = [count - 1]
    while found[-1]:
        found.append(int(before[found[-1]]))
    return np.array(found[::-1])


def _deviations(points: Floats) -> Floats:
    """Returns for each of the points (n, D) how far those before it are from the line to it, summed: float64 (n,)."""
    along = np.clip(points @ points.T / np.maximum((points * points).sum(axis=1), 1e-9), 0, 1)  # (point, end)
    off = np.abs(points[:, None] - along[:, :, None] * points).max(axis=2)
    return np.asarray(np.triu(off).sum(axis=0))


@dataclass(frozen=True)
class Handling:
    """First timesteps in which a gripper holds an object, releases it, and has released it."""

    grasp: int
    release: int
    end: int


def find_handling(actions: npt.NDArray[np.float32], is_gripper: Sequence[bool]) -> Handling | None:
    """Returns when a skill's object is handled; None where it is not.

    The release is the last time that the gripper moves, and the grasp the last time before in the other direction.

    `actions` are those of the skill, float32 (T, A); `is_gripper` tells of each number of an action.
    """
    speed = actions[:, np.array(is_gripper)].sum(axis=1)  # (T,)
    acting = np.flatnonzero(np.abs(speed) > _ACTING)
    if not len(acting):
        return None
    opposite = acting[np.sign(speed[acting]) != np.sign(speed[acting[-1]])]
    if not len(opposite):
        return None
    return Handling(int(opposite[-1]), int(acting[acting > opposite[-1]][0]), int(acting[-1]) + 1)
