"""How well recipes of skills are executed in `blocks`, by its true states: for evaluation, no learner comes near it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.cli.demo import blocks
from freerein.cli.demo.blocks import COLOURS, States

LIFTED_M = 0.02
"""Least rise of a block that was lifted."""

ELSEWHERE_M = 0.04
"""Least distance from where a block was to where it was put."""

UNDISTURBED_M = blocks.SIDE_M / 2
"""Most that any other block may have moved: half a block."""

_RESTING_M = 0.008


@dataclass(frozen=True, eq=False)
class Turn:
    """One skill of a recipe being executed.

    Attributes:
        skill: Its name, `move-COLOUR`.
        states: float64 (T, S), from the state in which its turn begins to the one in which the next one's does.
    """

    skill: str
    states: States


@dataclass(frozen=True)
class Outcome:
    """What came of a turn.

    Attributes:
        lifted: The skill's block rose.
        completed: It was also put down elsewhere, rests there, and no other block was moved.
    """

    lifted: bool
    completed: bool


def turns(recipe: Sequence[str], states: States, goal_index: npt.NDArray[np.integer[Any]]) -> list[Turn]:
    """Returns the turns of those skills of a recipe that a policy came to.

    Args:
        recipe: Skills, in order.
        states: float64 (T, S), what was true when the policy was asked.
        goal_index: int (T,), how many skills it was done with after it was asked; never falls.
    """
    bounds = np.searchsorted(goal_index, np.arange(len(recipe) + 1))  # the first moment of each turn
    return [
        Turn(skill, states[start : stop + 1])
        for skill, start, stop in zip(recipe, bounds, bounds[1:], strict=False)
        if start < stop
    ]


def judge(turn: Turn) -> Outcome:
    """Returns what came of a turn."""
    places = blocks.places(turn.states)  # (T, blocks, 3)
    mine = COLOURS.index(turn.skill.removeprefix("move-"))
    height = places[:, mine, 2]
    lifted = bool(height.max() - height[0] > LIFTED_M)
    moved = np.linalg.norm(places[-1] - places[0], axis=1)  # (blocks,)
    others_lie_still = bool(np.delete(moved, mine).max() <= UNDISTURBED_M)
    put_down = bool(moved[mine] >= ELSEWHERE_M) and rests(places[-1], mine)
    return Outcome(lifted, lifted and put_down and others_lie_still)


def rests(places: States, which: int) -> bool:
    """Returns whether a block lies on the table or on another block.

    Args:
        places: float64 (blocks, 3), x, y and z of their centres in metres; the table's top is z = 0.
        which: The block.
    """
    side = blocks.SIDE_M
    under = places[which] - np.delete(places, which, axis=0)  # (blocks - 1, 3)
    on_another = (np.abs(under[:, 2] - side) < _RESTING_M) & (np.abs(under[:, :2]) < side / 2).all(axis=1)
    return bool(abs(places[which, 2] - side / 2) < _RESTING_M or on_another.any())


def lifted_rate(outcomes: Sequence[Outcome], *, asked: int) -> float:
    """Returns the share of all skills asked for whose block was lifted."""
    return sum(outcome.lifted for outcome in outcomes) / asked


def skills_completed(outcomes: Sequence[Outcome], *, asked: int) -> float:
    """Returns the share of all skills asked for that were completed; those never come to are not."""
    return sum(outcome.completed for outcome in outcomes) / asked
