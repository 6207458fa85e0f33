"""How one block may lie to another, judged from true positions.

The dissertation's criteria (its table 4.1) hold for half of all random states, so here the blocks must also lie as if
placed: side by side on the table, or one resting on the other. x points to the front camera, y to its right, z up.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

BLOCK_M = 0.05
"""Edge of a block."""

_HALF = BLOCK_M / 2
_GAP_M = (-0.002, 0.035)
"""Gap between two blocks that lie beside one another. Negative is contact, where MuJoCo lets bodies overlap a little:
blocks that the gripper presses together overlap by up to half a millimetre."""

_RESTING_M = 0.008

Position = npt.NDArray[np.float64]
"""float64 (3,): x, y, z of a block's centre in metres; the table's top is z = 0."""


class BlockRelation(Enum):
    """The words of a goal between two blocks."""

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
    """One block in a relation to another.

    Attributes:
        first: Colour of the block that is to be moved.
        relation: Where it is to be.
        second: Colour of the block that it is told from.
    """

    first: str
    relation: BlockRelation
    second: str

    @property
    def name(self) -> str:
        """The goal in a task's name."""
        return f"{self.first}-{self.relation.value}-{self.second}"

    @property
    def text(self) -> str:
        """The goal in words."""
        return f"a {self.first} block {_PHRASES[self.relation]} a {self.second} block"


def holds(relation: BlockRelation, first: Position, second: Position) -> bool:
    """Returns whether the first block lies in the relation to the second."""
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
    """Returns whether the block is at the height of one lying on the table."""
    return bool(abs(block[2] - _HALF) < _RESTING_M)


def is_on(upper: Position, lower: Position) -> bool:
    """Returns whether `upper` is where a block resting on `lower` is: at most half a block off its centre."""
    offset = upper - lower
    return bool(abs(offset[2] - BLOCK_M) < _RESTING_M and np.all(np.abs(offset[:2]) < _HALF))
