"""The spatial criteria of table 4.1 (section 4.2), as data.

Unlike the five relations of `freerein.relations`, of which exactly one holds, criteria overlap: an image has the
caption of every criterion that holds. `on top of` and `below` are the relations of that name. The relations `to the
left of` and `to the right of` are these criteria of objects that are also close, and not one on the other. The relation
`apart from` is the negation of `close to`, in the one view that the relations know.

Keypoints are those of 2 or 3 nouns in one view: float (..., nouns, 2), x to the right and y down, in object widths.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from freerein.goal_text import WORDINGS
from freerein.relations import ABOVE, CLOSE, SpatialRelation

Keypoints = npt.NDArray[np.floating]
Margins = npt.NDArray[np.float64]

ALIGNED = 1.0
"""Largest horizontal distance between the centres of stacked objects, in object widths: eps_1 of table 4.1."""

STACKED = 0.5
"""Least vertical distance between the centres of stacked objects, in object widths. The table has 0: by that, what
stands a little farther back would be on top. The largest, eps_2, is `freerein.relations.ABOVE`."""

CONTAINER = 1.0
"""Width of what contains other things, in object widths, where nothing else is said: a thing is inside where the
centres are less than half of it apart. What is seen of a wide tray has its centre beside the thing that lies in it."""


class View(IntEnum):
    """A view of table 4.1; values are indices in a model's list of cameras."""

    FRONT = 0
    """A camera in front: x to the scene's right."""
    SIDE = 1
    """A camera at the left, which looks across the front camera's axis: x to the front."""
    TILTED = 2
    """A camera in front that looks down by about 45 degrees: right is right, and below is nearer."""


@dataclass(frozen=True)
class Criterion:
    """A spatial relation of two or three objects that is judged by their keypoints in one view.

    Attributes:
        name: Its name in configurations and figures.
        nouns: Number of objects, 2 or 3.
        view: The view whose keypoints it reads.
        margin: Returns by how much it holds of keypoints (..., nouns, 2), in object widths: float64 (...), positive if
            it holds. Comparisons are differences, a conjunction is the least of its parts (as the robustness of Donzé
            and Maler, "Robust satisfaction of temporal logic over real-valued signals", 2010).
        wordings: How texts say it, the caption first: formats of the nouns `{0}`, `{1}`, `{2}`.
        excludes: Names of the criteria that cannot hold of the same nouns in the same order.
    """

    name: str
    nouns: int
    view: View
    margin: Callable[[Keypoints], Margins]
    wordings: tuple[str, ...]
    excludes: tuple[str, ...] = ()

    def holds(self, keypoints: Keypoints) -> npt.NDArray[np.bool_]:
        """Returns where it holds, bool (...), at keypoints (..., nouns, 2).

        Raises ValueError for another number of nouns.
        """
        if keypoints.shape[-2:] != (self.nouns, 2):
            raise ValueError(f"{self.name} needs keypoints (..., {self.nouns}, 2); got {keypoints.shape}")
        holds: npt.NDArray[np.bool_] = self.margin(keypoints) > 0
        return holds


def _is_less(keypoints: Keypoints) -> Margins:
    """x1 < x2."""
    return np.asarray(keypoints[..., 1, 0] - keypoints[..., 0, 0], np.float64)


def _is_greater(keypoints: Keypoints) -> Margins:
    """x1 > x2."""
    return -_is_less(keypoints)


def _is_on_top(keypoints: Keypoints) -> Margins:
    """|x1 - x2| < `ALIGNED`, and `STACKED` < y2 - y1 < `ABOVE`; y is down."""
    height = keypoints[..., 1, 1] - keypoints[..., 0, 1]
    aligned = ALIGNED - np.abs(keypoints[..., 0, 0] - keypoints[..., 1, 0])
    return np.asarray(np.minimum(aligned, np.minimum(height - STACKED, ABOVE - height)), np.float64)


def _is_below(keypoints: Keypoints) -> Margins:
    """`_is_on_top` of the two in the other order."""
    return _is_on_top(keypoints[..., ::-1, :])


def _is_between(keypoints: Keypoints) -> Margins:
    """min(x2, x3) < x1 < max(x2, x3)."""
    x, others = keypoints[..., 0, 0], keypoints[..., 1:, 0]
    return np.asarray(np.minimum(x - others.min(axis=-1), others.max(axis=-1) - x), np.float64)


def _is_within(limit: float) -> Callable[[Keypoints], Margins]:
    def margin(keypoints: Keypoints) -> Margins:
        """|p1 - p2| < limit, by the Euclidean norm."""
        return np.asarray(limit - np.linalg.norm(keypoints[..., 0, :] - keypoints[..., 1, :], axis=-1), np.float64)

    return margin


def _after_first(*wordings: str) -> tuple[str, ...]:
    """Returns wordings that stand between two nouns, as formats."""
    return tuple(f"{{0}} {each} {{1}}" for each in wordings)


def _as_relation(relation: SpatialRelation) -> tuple[str, ...]:
    return _after_first(*WORDINGS[relation])


def criteria(*, container_width: float = CONTAINER) -> Mapping[str, Criterion]:
    """Returns the nine criteria of table 4.1 by name, in its order.

    Args:
        container_width: Width of what contains other things, in object widths.
    """
    inside = Criterion(
        "inside_of",
        2,
        View.TILTED,
        _is_within(container_width / 2),
        _after_first("inside of", "inside", "in", "into", "within"),
    )
    return MappingProxyType({each.name: each for each in (*_OTHERS, inside)})


_OTHERS = (
    Criterion("left_of", 2, View.FRONT, _is_less, _as_relation(SpatialRelation.LEFT_OF), ("right_of",)),
    Criterion("right_of", 2, View.FRONT, _is_greater, _as_relation(SpatialRelation.RIGHT_OF), ("left_of",)),
    Criterion("on_top_of", 2, View.FRONT, _is_on_top, _as_relation(SpatialRelation.ON_TOP_OF), ("below",)),
    Criterion("below", 2, View.FRONT, _is_below, _as_relation(SpatialRelation.BELOW), ("on_top_of",)),
    Criterion(
        "in_between",
        3,
        View.FRONT,
        _is_between,
        ("{0} in between {1} and {2}", "{0} between {1} and {2}", "{0} in the middle of {1} and {2}"),
    ),
    Criterion(
        "in_front_of",
        2,
        View.SIDE,
        _is_greater,
        _after_first("in front of", "in the front of", "just in front of", "directly in front of"),
        ("behind",),
    ),
    Criterion(
        "behind",
        2,
        View.SIDE,
        _is_less,
        _after_first("behind", "in back of", "just behind", "directly behind"),
        ("in_front_of",),
    ),
    Criterion(
        "close_to",
        2,
        View.TILTED,
        _is_within(CLOSE),
        _after_first("close to", "near", "near to", "next to", "beside", "adjacent to"),
    ),
)

CRITERIA = criteria()
"""The nine criteria with the usual container."""
