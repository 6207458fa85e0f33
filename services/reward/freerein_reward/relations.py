"""Spatial relations: their wordings, and their classification from two positions (section 4.2, table 4.1).

The table's criteria overlap; here they are tested in order, so that exactly one holds: on top of, below, apart from
(the negation of the table's `close to`), left of, right of.
"""

import re
from enum import IntEnum

import numpy as np
import numpy.typing as npt

CLOSE = 1.9
"""Largest distance between the centres of close objects, in object widths."""

ABOVE = 1.5
"""Largest vertical distance between the centres of stacked objects, in object widths."""


class SpatialRelation(IntEnum):
    """A spatial relation of one object to another; values are indices of arrays."""

    LEFT_OF = 0
    RIGHT_OF = 1
    ON_TOP_OF = 2
    BELOW = 3
    APART_FROM = 4


WORDINGS: dict[SpatialRelation, tuple[str, ...]] = {
    SpatialRelation.LEFT_OF: ("to the left of", "left of", "on the left of"),
    SpatialRelation.RIGHT_OF: ("to the right of", "right of", "on the right of"),
    SpatialRelation.ON_TOP_OF: ("on top of", "above", "on"),
    SpatialRelation.BELOW: ("below", "under", "beneath"),
    SpatialRelation.APART_FROM: ("apart from", "far from", "away from"),
}
"""The first of each is canonical: captions use it."""

_RELATION_OF = {wording: relation for relation, wordings in WORDINGS.items() for wording in wordings}
_RELATION = re.compile(
    r"\b(?:"
    + "|".join(wording.replace(" ", r"\s+") for wording in sorted(_RELATION_OF, key=len, reverse=True))
    + r")\b",
    re.IGNORECASE,
)


def caption(first: str, relation: SpatialRelation, second: str, *, wording: str = "") -> str:
    """Returns a caption, such as `a red block on top of a yellow block`, with the canonical wording by default."""
    return f"{first} {wording or WORDINGS[relation][0]} {second}"


def rival_captions(goal_text: str) -> tuple[str, ...]:
    """Returns the text with its first relation replaced by each other one; empty without a relation."""
    found = _RELATION.search(goal_text)
    if found is None:
        return ()
    relation = _RELATION_OF[" ".join(found[0].lower().split())]
    before, after = goal_text[: found.start()], goal_text[found.end() :]
    return tuple(f"{before}{WORDINGS[other][0]}{after}" for other in SpatialRelation if other is not relation)


def classify_relation(
    first: npt.NDArray[np.floating], second: npt.NDArray[np.floating], *, epsilon: float
) -> npt.NDArray[np.int8]:
    """Returns the relation of one object to another, int8 (...), values of `SpatialRelation`.

    Positions are float (..., 2), x to the right and y down. `epsilon` is the object width in the same unit: eps of
    table 4.1, in which `CLOSE` and `ABOVE` are measured.
    """
    x, height = first[..., 0] - second[..., 0], second[..., 1] - first[..., 1]
    aligned = np.abs(x) < epsilon
    tests = {
        SpatialRelation.ON_TOP_OF: aligned & (height > epsilon / 2) & (height < ABOVE * epsilon),
        SpatialRelation.BELOW: aligned & (height < -epsilon / 2) & (height > -ABOVE * epsilon),
        SpatialRelation.APART_FROM: np.hypot(x, height) >= CLOSE * epsilon,
        SpatialRelation.LEFT_OF: x < 0,
    }
    return np.select(list(tests.values()), list(tests), SpatialRelation.RIGHT_OF).astype(np.int8)
