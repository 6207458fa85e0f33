"""Predicates of the blocks tasks, on true positions in metres; the table top is z = 0."""

from functools import partial
from itertools import permutations

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.blocks.goals import BLOCK_M
from freerein_sim.worlds.predicates import AT_LANDMARK, OBJECT_MOVES, Flags, StatePredicate, States
from freerein_sim.worlds.world import WorldSpec

TOLERANCE_M = BLOCK_M / 2
"""Half a block: how far gripper and blocks may be from where a landmark has them."""

LIFTED_M = 0.02
"""Least rise of a lifted block."""

MOVED_M = 0.04
"""Least distance between a block's old and new place."""

UNDISTURBED_M = BLOCK_M / 2
"""Largest move of any other block: half a block."""

_RELATIONS = ("to the left of", "to the right of", "on top of", "below", "apart from")
_LEFT, _RIGHT, _ON_TOP, _BELOW, _APART = range(len(_RELATIONS))
_RESTING_M = 0.008
_CLOSE_M, _ABOVE_M = 0.095, 0.075
_VISIBLE_X_M = -0.6  # hidden blocks lie farther back


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
        """Returns five relations of each ordered pair of blocks, by the criteria of the dissertation's table 4.1.

        The criteria overlap. Tested in the order on top of, below, apart from, left, right, exactly one holds where
        both blocks are visible; none holds elsewhere.
        """
        return tuple(
            StatePredicate(
                f"relation/{first}-{words.removeprefix('to the ').replace(' ', '-')}-{second}",
                partial(self._is_related, self._colours.index(first), self._colours.index(second), relation),
                text=f"a {first} block {words} a {second} block",
                group=f"relation/{first}-{second}",
            )
            for first, second in permutations(self._colours, 2)
            for relation, words in enumerate(_RELATIONS)
        )

    def _positions(self, states: States) -> npt.NDArray[np.float64]:
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

    def _is_related(self, first: int, second: int, relation: int, states: States) -> Flags:
        positions = self._positions(states)
        visible = (positions[..., [first, second], 0] > _VISIBLE_X_M).all(axis=-1)
        offset = positions[..., first, :] - positions[..., second, :]  # (N, T, 3)
        right, up = offset[..., 1], offset[..., 2]
        aligned = np.abs(right) < BLOCK_M
        on_top = aligned & (up > BLOCK_M / 2) & (up < _ABOVE_M)
        below = aligned & (up < -BLOCK_M / 2) & (up > -_ABOVE_M)
        apart = np.hypot(right, up) >= _CLOSE_M
        true = np.select([on_top, below, apart, right < 0], [_ON_TOP, _BELOW, _APART, _LEFT], _RIGHT)
        return np.asarray(visible & (true == relation))


def is_resting(positions: npt.NDArray[np.float64], block: int) -> Flags:
    """Returns whether a block lies on the table or on another; positions are float64 (N, T, blocks, 3)."""
    offset = positions[..., [block], :] - np.delete(positions, block, axis=-2)  # (N, T, blocks - 1, 3)
    on_another = (np.abs(offset[..., 2] - BLOCK_M) < _RESTING_M) & (np.abs(offset[..., :2]) < BLOCK_M / 2).all(axis=-1)
    on_table = np.abs(positions[..., block, 2] - BLOCK_M / 2) < _RESTING_M
    return np.asarray(on_table | on_another.any(axis=-1))
