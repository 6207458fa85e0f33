"""How one thing may lie to another: in words, and judged from two pixels (section 4.2, table 4.1).

The table's criteria overlap, so that here they are asked in order and exactly one holds: on top of, below; then apart,
the contrary of the table's `close to`; else the thing is close and to the left or to the right.
"""

import re
from enum import IntEnum

import numpy as np
import numpy.typing as npt

CLOSE = 1.9
"""How many widths of a thing may lie between the middles of two that are close."""

ABOVE = 1.5
"""How many may lie between their heights when one is on top of the other."""


class Relation(IntEnum):
    """The words between two noun phrases; a value is the relation's place wherever relations are counted."""

    LEFT_OF = 0
    RIGHT_OF = 1
    ON_TOP_OF = 2
    BELOW = 3
    APART_FROM = 4


WORDINGS: dict[Relation, tuple[str, ...]] = {
    Relation.LEFT_OF: ("to the left of", "left of", "on the left of"),
    Relation.RIGHT_OF: ("to the right of", "right of", "on the right of"),
    Relation.ON_TOP_OF: ("on top of", "above", "on"),
    Relation.BELOW: ("below", "under", "beneath"),
    Relation.APART_FROM: ("apart from", "far from", "away from"),
}
"""The first of each is what captions say."""

_RELATION_OF = {wording: relation for relation, wordings in WORDINGS.items() for wording in wordings}
_FOUND = re.compile(
    r"\b(?:"
    + "|".join(wording.replace(" ", r"\s+") for wording in sorted(_RELATION_OF, key=len, reverse=True))
    + r")\b",
    re.IGNORECASE,
)


def caption(first: str, relation: Relation, second: str, *, wording: str = "") -> str:
    """Returns `a red block on top of a yellow block`, of two noun phrases; other words for the relation if given."""
    return f"{first} {wording or WORDINGS[relation][0]} {second}"


def rivals(goal_text: str) -> tuple[str, ...]:
    """Returns the same sentence with each other relation; nothing where no relation is found.

    Of several relations the first that is found changes.
    """
    found = _FOUND.search(goal_text)
    if found is None:
        return ()
    relation = _RELATION_OF[" ".join(found[0].lower().split())]
    before, after = goal_text[: found.start()], goal_text[found.end() :]
    return tuple(f"{before}{WORDINGS[other][0]}{after}" for other in Relation if other is not relation)


def judge(first: npt.NDArray[np.floating], second: npt.NDArray[np.floating], *, epsilon: float) -> npt.NDArray[np.int8]:
    """Returns how one thing lies to another.

    Args:
        first: float (..., 2), x to the right and y down.
        second: Likewise.
        epsilon: A thing's width, in the same unit: eps of table 4.1, of which the others are multiples.

    Returns:
        int8 (...), values of `Relation`.
    """
    x, height = first[..., 0] - second[..., 0], second[..., 1] - first[..., 1]
    aligned = np.abs(x) < epsilon
    tests = {
        Relation.ON_TOP_OF: aligned & (height > epsilon / 2) & (height < ABOVE * epsilon),
        Relation.BELOW: aligned & (height < -epsilon / 2) & (height > -ABOVE * epsilon),
        Relation.APART_FROM: np.hypot(x, height) >= CLOSE * epsilon,
        Relation.LEFT_OF: x < 0,
    }
    return np.select(list(tests.values()), list(tests), Relation.RIGHT_OF).astype(np.int8)
