"""Predicates of the blocks tasks, on true positions in metres; the table top is z = 0."""

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
from freerein_sim.worlds.predicates import AT_LANDMARK, OBJECT_MOVES, START, Flags, StatePredicate, States
from freerein_sim.worlds.world import WorldSpec

TOLERANCE_M = BLOCK_M / 2
"""Half a block: how far gripper and blocks may be from where a landmark has them."""

LIFTED_M = 0.02
"""Least rise of a lifted block."""

MOVED_M = 0.04
"""Least distance between a block's old and new place."""

UNDISTURBED_M = BLOCK_M / 2
"""Largest move of any other block: half a block."""


class BlockPredicates:
    """Makes the predicates of a task from the names of its true state."""

    def __init__(self, spec: WorldSpec) -> None:
        self._skills = spec.skills
        self._colours = [name.removesuffix(".x") for name in spec.state_names if name.endswith(".x")]
        self._gripper = [spec.state_names.index(f"gripper.{axis}") for axis in "yz"]
        self._blocks = np.array(
            [[spec.state_names.index(f"{each}.{axis}") for axis in "xyz"] for each in self._colours]
        )

    def landmarks_and_skills(self) -> tuple[StatePredicate, ...]:
        """Returns the predicates of landmarks and of the task's skills `move-COLOUR`."""
        blocks = {skill: self._colours.index(skill.removeprefix("move-")) for skill in self._skills}
        return (
            StatePredicate(AT_LANDMARK, self._is_at, needs_reference=True),
            StatePredicate(OBJECT_MOVES, self._needs_block_move, needs_reference=True),
            *(StatePredicate(f"lifted/{skill}", partial(self._is_lifted, block)) for skill, block in blocks.items()),
            *(StatePredicate(f"completed/{skill}", partial(self._is_moved, block)) for skill, block in blocks.items()),
        )

    def relations(self) -> tuple[StatePredicate, ...]:
        """Returns five relations of each ordered pair of blocks: one holds where both are visible, none elsewhere."""
        return tuple(
            StatePredicate(
                f"relation/{first}-{relation.value}-{second}",
                partial(self._is_related, self._colours.index(first), self._colours.index(second), relation),
                text=f"a {first} block {relation.text} a {second} block",
                group=f"relation/{first}-{second}",
            )
            for first, second in permutations(self._colours, 2)
            for relation in BlockRelation
        )

    def starts(self, goal: BlockGoal) -> tuple[StatePredicate, ...]:
        """Returns what tells the episodes of a goal apart by the order in which its blocks began."""
        pair = self._colours.index(goal.first), self._colours.index(goal.second)
        name = "from-left" if goal.relation is BlockRelation.ON_TOP_OF else "in-order"
        return (StatePredicate(START + name, partial(self._begins, pair, goal.relation is BlockRelation.RIGHT_OF)),)

    def _begins(self, pair: tuple[int, int], on_right: bool, states: States) -> Flags:
        """The first block of the pair begins on the left of the second, or on its right."""
        first, second = (states[..., :1, self._blocks[block, 1]] for block in pair)  # (N, 1)
        return np.repeat(first > second if on_right else first < second, states.shape[1], axis=1)

    def _positions(self, states: States) -> Position:
        """Returns the blocks' centres, float64 (N, T, blocks, 3)."""
        return states[..., self._blocks]

    def _is_at(self, states: States, references: States) -> Flags:
        """The gripper may be off by 2.5 cm along each axis, and each block's centre by 2.5 cm in all."""
        off = np.abs(states[..., self._gripper] - references[..., self._gripper]).max(axis=-1)  # (N, T)
        return np.asarray((off <= TOLERANCE_M) & ~self._needs_block_move(states, references))

    def _needs_block_move(self, states: States, references: States) -> Flags:
        moved = np.linalg.norm(self._positions(states) - self._positions(references), axis=-1)  # (N, T, blocks)
        return np.asarray(moved.max(axis=-1) > TOLERANCE_M)

    def _is_lifted(self, block: int, states: States) -> Flags:
        height = states[..., self._blocks[block, 2]]  # (N, T)
        return np.asarray(np.maximum.accumulate(height, axis=1) - height[:, :1] > LIFTED_M)

    def _is_moved(self, block: int, states: States) -> Flags:
        """The block was lifted and rests elsewhere, and no other block was moved."""
        positions = self._positions(states)
        moved = np.linalg.norm(positions - positions[:, :1], axis=-1)  # (N, T, blocks)
        put_down = (moved[..., block] >= MOVED_M) & is_resting(positions, block)
        others_undisturbed = np.delete(moved, block, axis=-1).max(axis=-1) <= UNDISTURBED_M
        return np.asarray(self._is_lifted(block, states) & put_down & others_undisturbed)

    def _is_related(self, first: int, second: int, relation: BlockRelation, states: States) -> Flags:
        positions = self._positions(states)
        one, other = positions[..., first, :], positions[..., second, :]
        return np.asarray(is_visible(one) & is_visible(other) & is_related(relation, one, other))


def is_resting(positions: Position, block: int) -> Flags:
    """Returns whether a block lies on the table or on another; positions are float64 (N, T, blocks, 3)."""
    others = np.delete(positions, block, axis=-2)  # (N, T, blocks - 1, 3)
    on_another = is_on(positions[..., [block], :], others).any(axis=-1)
    return np.asarray(is_on_table(positions[..., block, :]) | on_another)
