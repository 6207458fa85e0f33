"""True relations between blocks: the criteria of the dissertation's table 4.1 on true positions in metres.

The criteria overlap. Tested in this order exactly one holds: on top of, below, apart from, left, right.
"""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
import numpy.typing as npt

from freerein.cli.demo.evaluation.blocks import COLOURS, SIDE_M, States, block_positions

RELATIONS = ("to the left of", "to the right of", "on top of", "below", "apart from")
"""The words between two noun phrases."""

_CLOSE_M, _ABOVE_M = 0.095, 0.075
_VISIBLE_X_M = -0.6  # hidden blocks lie farther back


@dataclass(frozen=True)
class BlockPair:
    """Colours of two blocks: the subject, whose place is described, and the reference."""

    first: str
    second: str

    @property
    def phrases(self) -> tuple[str, str]:
        """The two noun phrases."""
        return f"a {self.first} block", f"a {self.second} block"

    @property
    def texts(self) -> tuple[str, ...]:
        """One sentence per entry of `RELATIONS`."""
        first, second = self.phrases
        return tuple(f"{first} {relation} {second}" for relation in RELATIONS)


def visible_pairs(states: States) -> dict[BlockPair, npt.NDArray[np.int64]]:
    """Returns, by ordered pair of blocks, the indices of the states (N, S) in which both blocks are visible."""
    visible = dict(zip(COLOURS, (block_positions(states)[:, :, 0] > _VISIBLE_X_M).T, strict=True))
    pairs = (BlockPair(*colours) for colours in permutations(COLOURS, 2))
    both = {pair: np.flatnonzero(visible[pair.first] & visible[pair.second]) for pair in pairs}
    return {pair: indices for pair, indices in both.items() if len(indices)}


def true_relations(states: States, pair: BlockPair) -> npt.NDArray[np.int64]:
    """Returns the relation that holds in each state (N, S): int64 (N,), indices into `RELATIONS`."""
    blocks = block_positions(states)  # (N, blocks, 3)
    offset = blocks[:, COLOURS.index(pair.first)] - blocks[:, COLOURS.index(pair.second)]
    right, up = offset[:, 1], offset[:, 2]
    aligned = np.abs(right) < SIDE_M
    on_top = aligned & (up > SIDE_M / 2) & (up < _ABOVE_M)
    below = aligned & (up < -SIDE_M / 2) & (up > -_ABOVE_M)
    apart = np.hypot(right, up) >= _CLOSE_M
    return np.select([on_top, below, apart, right < 0], [2, 3, 4, 0], 1).astype(np.int64)
