"""Goals: spatial relations between two blocks, judged from true positions.

The dissertation's criteria (table 4.1) hold in half of all random states, so here the blocks must also lie side by side
on the table, or one must rest on the other. x points to the front camera, y to its right, z up.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

BLOCK_M = 0.05
"""Edge length of a block."""

_HALF = BLOCK_M / 2
_GAP_M = (-0.002, 0.035)
"""Allowed gap between blocks side by side. Negative gaps are contact: MuJoCo lets bodies overlap, by up to half a
millimetre when the gripper presses blocks together."""

_RESTING_M = 0.008

Position = npt.NDArray[np.float64]
"""float64 (3,): x, y, z of a block's centre in metres; the table top is z = 0."""


class BlockRelation(Enum):
    """Spatial relation of one block to another."""

    LEFT_OF = "left-of"
    RIGHT_OF = "right-of"
    ON_TOP_OF = "on-top-of"


_PHRASES = {
    BlockRelation.LEFT_OF: "to the left of",
    BlockRelation.RIGHT_OF: "to the right of",
    BlockRelation.ON_TOP_OF: "on top of",
}


@dataclass(frozen=True)
class BlockGoal:
    """The block of colour `first`, which is moved, in a relation to the block of colour `second`."""

    first: str
    relation: BlockRelation
    second: str

    @property
    def name(self) -> str:
        """The goal as part of a task name."""
        return f"{self.first}-{self.relation.value}-{self.second}"

    @property
    def text(self) -> str:
        """The goal in words."""
        return f"a {self.first} block {_PHRASES[self.relation]} a {self.second} block"


def holds(relation: BlockRelation, first: Position, second: Position) -> bool:
    """Returns whether the relation of the first block to the second holds."""
    if relation is BlockRelation.ON_TOP_OF:
        return is_on(first, second)
    beside = second - first if relation is BlockRelation.LEFT_OF else first - second
    return bool(
        is_on_table(first)
        and is_on_table(second)
        and abs(beside[0]) < _HALF
        and _GAP_M[0] < beside[1] - BLOCK_M < _GAP_M[1]
    )


def is_on_table(block: Position) -> bool:
    """Returns whether the block rests on the table, by its height."""
    return bool(abs(block[2] - _HALF) < _RESTING_M)


def is_on(upper: Position, lower: Position) -> bool:
    """Returns whether `upper` rests on `lower`, at most half a block off its centre."""
    offset = upper - lower
    return bool(abs(offset[2] - BLOCK_M) < _RESTING_M and np.all(np.abs(offset[:2]) < _HALF))
