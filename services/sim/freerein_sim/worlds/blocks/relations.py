"""Spatial relations of two blocks: the numbers and the one classification by which oracle, captions and starts judge.

The criteria are those of the dissertation's table 4.1. There they overlap; here they are tested in one order, so that
every pair of blocks is in exactly one relation. x points to the front camera, y to its right, z up; the table top is
z = 0.
"""

from enum import Enum

import numpy as np
import numpy.typing as npt

BLOCK_M = 0.05
"""Edge length of a block."""

CLOSE_M = 0.095
"""Blocks whose centres are farther apart than this are apart. Nearer ones side by side are beside each other; blocks
that touch, and that MuJoCo lets overlap by half a millimetre, are, too."""

PLACED_ASIDE_M = 0.071
"""Distance between centres at which the expert places a block beside another."""

_ABOVE_M = (BLOCK_M / 2, 0.075)
"""How much higher the centre of a block on top of another may be."""

_RESTING_M = 0.008
"""How far the height of a block at rest may be from that of one that was put down exactly."""

_VISIBLE_X_M = -0.6
"""Blocks farther back are hidden behind the wall."""

Position = npt.NDArray[np.float64]
"""float64 (..., 3): x, y, z of blocks' centres in metres."""

Flags = npt.NDArray[np.bool_]
"""bool (...)."""


class BlockRelation(Enum):
    """Spatial relation of one block to another."""

    LEFT_OF = "left-of"
    RIGHT_OF = "right-of"
    ON_TOP_OF = "on-top-of"
    BELOW = "below"
    APART_FROM = "apart-from"

    @property
    def text(self) -> str:
        """The relation in words."""
        return _PHRASES[self]


_PHRASES = {
    BlockRelation.LEFT_OF: "to the left of",
    BlockRelation.RIGHT_OF: "to the right of",
    BlockRelation.ON_TOP_OF: "on top of",
    BlockRelation.BELOW: "below",
    BlockRelation.APART_FROM: "apart from",
}


def is_related(relation: BlockRelation, first: Position, second: Position) -> Flags:
    """Returns where the first block is in a relation to the second; exactly one of the five is true."""
    offset = first - second
    right, up = offset[..., 1], offset[..., 2]
    aligned = np.abs(right) < BLOCK_M
    on_top = aligned & (_ABOVE_M[0] < up) & (up < _ABOVE_M[1])
    below = aligned & (_ABOVE_M[0] < -up) & (-up < _ABOVE_M[1])
    beside = ~(on_top | below) & ((offset * offset).sum(axis=-1) < CLOSE_M**2)
    match relation:
        case BlockRelation.ON_TOP_OF:
            related = on_top
        case BlockRelation.BELOW:
            related = below
        case BlockRelation.LEFT_OF:
            related = beside & (right < 0)
        case BlockRelation.RIGHT_OF:
            related = beside & (right >= 0)
        case BlockRelation.APART_FROM:
            related = ~(on_top | below | beside)
    return np.asarray(related)


def holds(relation: BlockRelation, first: Position, second: Position) -> Flags:
    """Returns where the relation is true of blocks at rest: on the table, or one on the other. A held one is not."""
    at_rest = (is_on_table(first) & is_on_table(second)) | is_on(first, second) | is_on(second, first)
    return np.asarray(is_related(relation, first, second) & at_rest)


def is_on_table(block: Position) -> Flags:
    """Returns where a block rests on the table, by its height."""
    return np.asarray(np.abs(block[..., 2] - BLOCK_M / 2) < _RESTING_M)


def is_on(upper: Position, lower: Position) -> Flags:
    """Returns where `upper` rests on `lower`, at most half a block off its centre."""
    offset = upper - lower
    at_height = np.abs(offset[..., 2] - BLOCK_M) < _RESTING_M
    return np.asarray(at_height & (np.abs(offset[..., :2]) < BLOCK_M / 2).all(axis=-1))


def is_visible(block: Position) -> Flags:
    """Returns where a block is on show, not hidden behind the wall."""
    return np.asarray(block[..., 0] > _VISIBLE_X_M)
