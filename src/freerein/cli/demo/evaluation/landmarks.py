"""Landmarks reached in `blocks`: a landmark is a goal image of a rollout, and it is reached by true states."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.cli.demo.evaluation import blocks
from freerein.cli.demo.evaluation.blocks import States
from freerein.errors import InvalidInput

Flags = npt.NDArray[np.bool_]

TOLERANCE_M = blocks.SIDE_M / 2
"""Half a block."""

SPACING_STEPS = 6
"""Timesteps from one landmark to the next."""


@dataclass(frozen=True, eq=False)
class LandmarkPursuit:
    """Which landmark a robot pursued at each of T timesteps, and whether it was there.

    Attributes:
        landmark: int64 (T,), index of the landmark pursued; N where all N landmarks are done.
        at_landmark: bool (T,), whether the robot was truly at it.
        left: bool (T,), whether the reply ended the pursuit, as reached or as abandoned.
        count: N, the number of landmarks.
    """

    landmark: npt.NDArray[np.int64]
    at_landmark: Flags
    left: Flags
    count: int

    @property
    def is_active(self) -> Flags:
        """Whether a landmark was still pursued: bool (T,)."""
        return self.landmark < self.count

    @property
    def reached(self) -> Flags:
        """Whether the robot was at the landmark at some time while it pursued it: bool (N,)."""
        return np.array([self.at_landmark[self.landmark == index].any() for index in range(self.count)], bool)

    @property
    def recognized(self) -> Flags:
        """Whether the robot was at the landmark when it left it for the next one: bool (N,)."""
        ends = self.at_landmark & self.left
        return np.array([ends[self.landmark == index].any() for index in range(self.count)], bool)


@dataclass(frozen=True)
class ReachedRates:
    """Shares in [0, 1] of landmarks reached: of all, and by whether some block must move to reach them."""

    overall: float
    block_moves: float
    no_block_moves: float


def landmark_steps(length: int, *, count: int) -> npt.NDArray[np.int64]:
    """Returns the timesteps of the landmarks of a trajectory, int64 (N,): every 6th, at most `count`."""
    return np.arange(SPACING_STEPS, length, SPACING_STEPS, dtype=np.int64)[:count]


def is_at(states: States, landmark: States) -> Flags:
    """Returns whether gripper and blocks are where a landmark has them, bool (...), for float64 states (..., S).

    The gripper may be off by 2.5 cm along each axis, and each block's centre by 2.5 cm in all.
    """
    gripper = np.abs(blocks.gripper_positions(states) - blocks.gripper_positions(landmark)).max(axis=-1)  # (...)
    return np.asarray((gripper <= TOLERANCE_M) & ~needs_block_move(states, landmark))


def needs_block_move(states: States, landmark: States) -> Flags:
    """Returns whether some block is more than 2.5 cm from where a landmark has it, bool (...); arguments as `is_at`."""
    moved = np.linalg.norm(blocks.block_positions(states) - blocks.block_positions(landmark), axis=-1)  # (..., blocks)
    return np.asarray(moved.max(axis=-1) > TOLERANCE_M)


def pursue(states: States, goal_index: npt.NDArray[np.integer[Any]], landmark_states: States) -> LandmarkPursuit:
    """Returns how a policy pursued a robot's landmarks.

    Args:
        states: float64 (T, S), the true state of each observation.
        goal_index: int (T,), landmarks done with according to the reply to each observation; it never falls.
        landmark_states: float64 (N, S).
    """
    if len(states) != len(goal_index):
        raise InvalidInput(f"There must be one reply per state; got {len(goal_index)} and {len(states)}.")
    count = len(landmark_states)
    pursued = np.minimum(np.concatenate([[0], goal_index[:-1]])[: len(states)], count)
    at_landmark = is_at(states, landmark_states[np.minimum(pursued, count - 1)]) & (pursued < count)
    return LandmarkPursuit(pursued.astype(np.int64), at_landmark, np.asarray(goal_index > pursued), count)


def reached_at_random(states: States, landmark_states: States, *, max_steps: int) -> Flags:
    """Returns which of N landmarks a robot that acts at random reached, bool (N,), from its states float64 (T, S).

    It goes on to the next landmark as soon as it truly is at one, which no policy can know, or after `max_steps`.
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


def reached_rates(reached: Flags, block_moves: Flags) -> ReachedRates:
    """Returns the shares of landmarks reached, bool (M,); `block_moves`, bool (M,), must hold both kinds."""
    if not 0 < block_moves.sum() < len(block_moves):
        raise InvalidInput("Landmarks must include some that need a block moved and some that do not; got one kind.")
    return ReachedRates(float(reached.mean()), float(reached[block_moves].mean()), float(reached[~block_moves].mean()))
