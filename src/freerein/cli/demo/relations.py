"""How blocks truly lie to one another, for evaluation: the criteria of table 4.1 on true positions in metres.

The criteria overlap; in this order exactly one holds: on top of, below; apart, the contrary of close; left, right.
"""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
import numpy.typing as npt

from freerein.cli.demo.blocks import COLOURS, SIDE_M, States, places

RELATIONS = ("to the left of", "to the right of", "on top of", "below", "apart from")
"""The words between two noun phrases."""

_CLOSE_M, _ABOVE_M = 0.095, 0.075
_ON_SHOW_M = -0.6  # blocks that are parked lie farther back


@dataclass(frozen=True)
class Pair:
    """Two blocks, in order.

    Attributes:
        first: The colour of the block that is told of.
        second: The colour of the block that it is told from.
    """

    first: str
    second: str

    @property
    def phrases(self) -> tuple[str, str]:
        """The noun phrases."""
        return f"a {self.first} block", f"a {self.second} block"

    @property
    def texts(self) -> tuple[str, ...]:
        """A sentence for each of `RELATIONS`."""
        first, second = self.phrases
        return tuple(f"{first} {relation} {second}" for relation in RELATIONS)


def questions(states: States) -> dict[Pair, npt.NDArray[np.int64]]:
    """Returns for each ordered pair of blocks the states, of (N, S), in which both are on show."""
    shown = dict(zip(COLOURS, (places(states)[:, :, 0] > _ON_SHOW_M).T, strict=True))
    pairs = (Pair(*colours) for colours in permutations(COLOURS, 2))
    both = {pair: np.flatnonzero(shown[pair.first] & shown[pair.second]) for pair in pairs}
    return {pair: which for pair, which in both.items() if len(which)}


def truth(states: States, pair: Pair) -> npt.NDArray[np.int64]:
    """Returns the relation that holds in each of the states (N, S): int64 (N,), an index into `RELATIONS`."""
    blocks = places(states)  # (N, blocks, 3)
    offset = blocks[:, COLOURS.index(pair.first)] - blocks[:, COLOURS.index(pair.second)]
    right, up = offset[:, 1], offset[:, 2]
    aligned = np.abs(right) < SIDE_M
    on_top = aligned & (up > SIDE_M / 2) & (up < _ABOVE_M)
    below = aligned & (up < -SIDE_M / 2) & (up > -_ABOVE_M)
    apart = np.hypot(right, up) >= _CLOSE_M
    return np.select([on_top, below, apart, right < 0], [2, 3, 4, 0], 1).astype(np.int64)
