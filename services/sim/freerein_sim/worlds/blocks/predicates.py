"""Predicates of the blocks tasks, on true positions in metres; the table top is z = 0."""

from collections.abc import Sequence
from functools import partial
from itertools import permutations

import numpy as np

from freerein_sim.worlds.blocks.goals import BlockGoal
from freerein_sim.worlds.blocks.relations import (
    BLOCK_M,
    BlockRelation,
    Position,
    is_on,
    is_on_table,
    is_related,
    is_visible,
)
from freerein_sim.worlds.blocks.spec import COLOURS, STATE_NAMES
from freerein_sim.worlds.moved_objects import MovedObjects
from freerein_sim.worlds.predicates import START, Flags, StatePredicate, States

_LIFTED_M = 0.02
"""Least rise of a lifted block."""

_MOVED_M = 0.04
"""Least distance between a block's old and new place."""

_UNDISTURBED_M = BLOCK_M / 2
"""Largest move of any other block: half a block."""

_OBJECTS = MovedObjects(STATE_NAMES, gripper_axes="yz", names=COLOURS, lifted_m=_LIFTED_M)


def landmarks_and_skills(skills: Sequence[str]) -> tuple[StatePredicate, ...]:
    """Returns the predicates of landmarks and of skills `move-COLOUR`."""
    return _OBJECTS.predicates({skill: COLOURS.index(skill.removeprefix("move-")) for skill in skills}, _is_moved)


def relations() -> tuple[StatePredicate, ...]:
    """Returns five relations of each ordered pair of blocks: one holds where both are visible, none elsewhere."""
    return tuple(
        StatePredicate(
            f"relation/{first}-{relation.value}-{second}",
            partial(_is_related, COLOURS.index(first), COLOURS.index(second), relation),
            text=f"a {first} block {relation.text} a {second} block",
            group=f"relation/{first}-{second}",
        )
        for first, second in permutations(COLOURS, 2)
        for relation in BlockRelation
    )


def starts(goal: BlockGoal) -> tuple[StatePredicate, ...]:
    """Returns the predicate of the order in which a goal's blocks began."""
    pair = COLOURS.index(goal.first), COLOURS.index(goal.second)
    name = "from-left" if goal.relation is BlockRelation.ON_TOP_OF else "in-order"
    return (StatePredicate(START + name, partial(_begins, pair, goal.relation is BlockRelation.RIGHT_OF)),)


def _begins(pair: tuple[int, int], on_right: bool, states: States) -> Flags:
    """The first block of the pair begins on the left of the second, or on its right."""
    first, second = (states[..., :1, _OBJECTS.objects[block, 1]] for block in pair)  # (N, 1)
    return np.repeat(first > second if on_right else first < second, states.shape[1], axis=1)


def _is_moved(block: int, states: States) -> Flags:
    """The block was lifted and rests elsewhere, and no other block was moved."""
    positions = states[..., _OBJECTS.objects]  # (N, T, blocks, 3)
    moved = np.linalg.norm(positions - positions[:, :1], axis=-1)  # (N, T, blocks)
    put_down = (moved[..., block] >= _MOVED_M) & _is_resting(positions, block)
    others_undisturbed = np.delete(moved, block, axis=-1).max(axis=-1) <= _UNDISTURBED_M
    return np.asarray(_OBJECTS.is_lifted(block, states) & put_down & others_undisturbed)


def _is_related(first: int, second: int, relation: BlockRelation, states: States) -> Flags:
    one, other = (states[..., _OBJECTS.objects[block]] for block in (first, second))
    return np.asarray(is_visible(one) & is_visible(other) & is_related(relation, one, other))


def _is_resting(positions: Position, block: int) -> Flags:
    """Returns whether a block lies on the table or on another; positions are float64 (N, T, blocks, 3)."""
    others = np.delete(positions, block, axis=-2)  # (N, T, blocks - 1, 3)
    on_another = is_on(positions[..., [block], :], others).any(axis=-1)
    return np.asarray(is_on_table(positions[..., block, :]) | on_another)
