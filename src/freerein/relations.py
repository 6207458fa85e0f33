"""Spatial relations: their canonical wordings, and their classification from two positions (section 4.2, table 4.1).

The table's criteria overlap; here they are tested in order, so that exactly one holds: on top of, below, apart from
(the negation of the table's `close to`), left of, right of.
"""

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType

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


CANONICAL_WORDINGS: Mapping[SpatialRelation, str] = MappingProxyType(
    {
        SpatialRelation.LEFT_OF: "to the left of",
        SpatialRelation.RIGHT_OF: "to the right of",
        SpatialRelation.ON_TOP_OF: "on top of",
        SpatialRelation.BELOW: "below",
        SpatialRelation.APART_FROM: "apart from",
    }
)
"""The wordings of captions; `freerein.goal_text` reads others."""


MISSING = "missing"


def caption(first: str, relation: SpatialRelation, second: str) -> str:
    """Returns a caption, such as `a red block on top of a yellow block`."""
    return f"{first} {CANONICAL_WORDINGS[relation]} {second}"


def absence_caption(first: str, second: str) -> str:
    """Returns the caption of an image that does not show both, such as `a red block or a yellow block missing`.

    It rivals every relation of the two: nothing can be to the left of what is not there.
    """
    return f"{first} or {second} {MISSING}"


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
