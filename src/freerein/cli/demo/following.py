"""How well landmarks are followed in `blocks`, by its true states: for evaluation, no learner comes near it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.cli.demo import blocks
from freerein.cli.demo.blocks import States
from freerein.errors import InvalidInput

Flags = npt.NDArray[np.bool_]

TOLERANCE_M = blocks.SIDE_M / 2
"""Half a block."""

EVERY_STEPS = 6
"""Timesteps from one landmark to the next."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Which of a trajectory's N landmarks were reached.

    Attributes:
        when_left: bool (N,), the robot was there when it went on to the next one, whether it said so or gave up.
        ever: bool (N,), it was there at some moment while this was the landmark pursued.
    """

    when_left: Flags
    ever: Flags


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of frames, and whether they are close, by time alone.

    Attributes:
        observations: int64 (P, 2), trajectory and timestep of what is seen.
        goals: int64 (P, 2), of the goal.
        close: bool (P,), the two are a few timesteps apart.
    """

    observations: npt.NDArray[np.int64]
    goals: npt.NDArray[np.int64]
    close: Flags


def landmarks(length: int, *, count: int) -> npt.NDArray[np.int64]:
    """Returns the timesteps of the landmarks of a trajectory, int64 (N,): every 6th, at most `count`.

    Args:
        length: Timesteps of the trajectory.
        count: Most landmarks.
    """
    return np.arange(EVERY_STEPS, length, EVERY_STEPS, dtype=np.int64)[:count]


def is_at(states: States, landmark: States) -> Flags:
    """Returns whether gripper and blocks are where a landmark has them, bool (...).

    The gripper may be off by 2.5 cm along each axis, and each block's centre by 2.5 cm in all.

    Args:
        states: float64 (..., S).
        landmark: float64 (S,) or (..., S).
    """
    gripper = np.abs(blocks.grippers(states) - blocks.grippers(landmark)).max(axis=-1)  # (...)
    moved = np.linalg.norm(blocks.places(states) - blocks.places(landmark), axis=-1).max(axis=-1)  # (...)
    return np.asarray((gripper <= TOLERANCE_M) & (moved <= TOLERANCE_M))


def followed(states: States, goal_index: npt.NDArray[np.integer[Any]], landmark_states: States) -> Followed:
    """Returns which landmarks a policy reached; those it did not come to pursue are not reached.

    Args:
        states: float64 (T, S), the true state of each observation.
        goal_index: int (T,), landmarks done with according to the reply to each observation; it never falls.
        landmark_states: float64 (N, S).

    Raises:
        InvalidInput: There are not as many states as replies.
    """
    if len(states) != len(goal_index):
        raise InvalidInput(f"There must be a reply to each state; got {len(states)} and {len(goal_index)}.")
    pursued = np.concatenate([[0], goal_index[:-1]])[: len(states)]
    when_left, ever = np.zeros((2, len(landmark_states)), bool)
    for t in np.flatnonzero(pursued < len(landmark_states)):
        there = bool(is_at(states[t], landmark_states[pursued[t]]))
        ever[pursued[t]] |= there
        when_left[pursued[t]] |= there and goal_index[t] > pursued[t]
    return Followed(when_left, ever)


def by_chance(states: States, landmark_states: States, *, max_steps: int) -> Flags:
    """Returns which landmarks somebody who acts at random reached, bool (N,).

    It goes on to the next landmark as soon as it truly is at one, which no policy can know, or after `max_steps`.

    Args:
        states: float64 (T, S), from the first state on.
        landmark_states: float64 (N, S).
        max_steps: Control steps for each landmark.
    """
    reached, index, steps = np.zeros(len(landmark_states), bool), 0, 0
    for state in states:
        if index == len(reached):
            break
        reached[index] = is_at(state, landmark_states[index])
        if reached[index] or steps == max_steps:
            index, steps = index + 1, 0
        steps += 1
    return reached


def pairs(
    lengths: npt.NDArray[np.int64], rng: np.random.Generator, *, count: int, close_steps: int, far_steps: int
) -> Pairs:
    """Returns random pairs of frames to judge a goal recognizer by, half of them close.

    Those that are not close are of different trajectories, or of one and more than `far_steps` apart: half each where
    the trajectories are long enough.

    Args:
        lengths: int64 (n,), the timesteps of each trajectory, 2 or more of them.
        rng: Draws them.
        count: Pairs.
        close_steps: Most timesteps between close frames.
        far_steps: Timesteps that frames which are not close are more than apart.
    """
    observations, goals, close = [], [], np.arange(count) % 2 == 0
    for is_close, elsewhere in zip(close, np.arange(count) % 4 == 1, strict=True):
        item, other = rng.choice(len(lengths), 2, replace=False)
        goal = int(rng.integers(lengths[item]))
        apart = np.abs(np.arange(lengths[item]) - goal)
        allowed = np.flatnonzero(apart <= close_steps if is_close else apart > far_steps)
        if not is_close and (elsewhere or not len(allowed)):
            observations.append((other, int(rng.integers(lengths[other]))))
        else:
            observations.append((item, int(rng.choice(allowed))))
        goals.append((item, goal))
    return Pairs(np.array(observations, np.int64), np.array(goals, np.int64), close)
