"""Skills completed in `blocks`: a skill `move-COLOUR` lifts its block and puts it down elsewhere."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.cli.demo.evaluation.blocks import COLOURS, SIDE_M, States, block_positions

LIFTED_M = 0.02
"""Least rise of a lifted block."""

MOVED_M = 0.04
"""Least distance between a block's old and new place."""

UNDISTURBED_M = SIDE_M / 2
"""Largest move of any other block: half a block."""

_RESTING_M = 0.008


@dataclass(frozen=True)
class SkillOutcome:
    """Result of an attempt at a skill.

    Attributes:
        lifted: Whether the skill's block rose.
        completed: Whether it was also put down elsewhere, rests there, and no other block was moved.
    """

    lifted: bool
    completed: bool


def attempts(
    recipe: Sequence[str], states: States, goal_index: npt.NDArray[np.integer[Any]]
) -> list[tuple[str, States]]:
    """Returns each skill of a recipe that the policy started, with its states up to the first of the next skill.

    `states` are float64 (T, S); `goal_index`, int (T,), counts the skills done according to the reply to each; it never
    falls.
    """
    bounds = np.searchsorted(goal_index, np.arange(len(recipe) + 1))  # first timestep of each skill
    return [
        (skill, states[start : stop + 1])
        for skill, start, stop in zip(recipe, bounds, bounds[1:], strict=False)
        if start < stop
    ]


def outcome(skill: str, states: States) -> SkillOutcome:
    """Returns the result of an attempt at a skill `move-COLOUR`, given its states float64 (T, S)."""
    positions = block_positions(states)  # (T, blocks, 3)
    target = COLOURS.index(skill.removeprefix("move-"))
    height = positions[:, target, 2]
    lifted = bool(height.max() - height[0] > LIFTED_M)
    moved = np.linalg.norm(positions[-1] - positions[0], axis=1)  # (blocks,)
    others_undisturbed = bool(np.delete(moved, target).max() <= UNDISTURBED_M)
    put_down = bool(moved[target] >= MOVED_M) and is_resting(positions[-1], target)
    return SkillOutcome(lifted, lifted and put_down and others_undisturbed)


def is_resting(positions: States, block: int) -> bool:
    """Returns whether a block lies on the table, z = 0, or on another; positions are float64 (blocks, 3) in metres."""
    offset = positions[block] - np.delete(positions, block, axis=0)  # (blocks - 1, 3)
    on_another = (np.abs(offset[:, 2] - SIDE_M) < _RESTING_M) & (np.abs(offset[:, :2]) < SIDE_M / 2).all(axis=1)
    return bool(abs(positions[block, 2] - SIDE_M / 2) < _RESTING_M or on_another.any())
