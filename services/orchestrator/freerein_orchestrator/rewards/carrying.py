"""Nearness of an object to its goal position beside another, or to the other itself, from the keypoints of both.

Objects do not pass through each other: the way to the other side leads over the top.
"""

from collections.abc import Callable, Mapping
from functools import partial

import torch
from torch import Tensor

from freerein.criteria import CRITERIA
from freerein.criterion_text import stated_criterion
from freerein.learning.actor_critic.ways import way_around
from freerein.relations import CANONICAL_WORDINGS, CLOSE, SpatialRelation

_REACH = 6.0
"""Length of the way, in object widths, from which an object is no nearer than from any other."""

_RADIUS = 1.0
"""Radius of the obstacle on the way: an object and half of the carried one."""

_PLACES: Mapping[SpatialRelation, tuple[float, float]] = {
    SpatialRelation.LEFT_OF: (-1.45, 0.0),
    SpatialRelation.RIGHT_OF: (1.45, 0.0),
    SpatialRelation.ON_TOP_OF: (0.0, 1.0),
}
"""The middle of where table 4.1 has each relation, in object widths to the right and up of the second object."""


def nearness_of(caption: str) -> Callable[[Tensor], Tensor] | None:
    """Returns what gives the nearness of the first object to where a goal has it, of its offset from the second.

    `close to` is near the second object, wherever; None where the goal has it nowhere, such as `apart from`.
    """
    place = goal_place(caption)
    if place is not None:
        return partial(nearness, place=place)
    criterion, _ = stated_criterion(caption) or (None, ())
    return nearness_to_second if criterion is CRITERIA["close_to"] else None


def nearness_to_second(offset: Tensor) -> Tensor:
    """Returns the nearness of the first object to being close to the second, float32 (...), in [0, 6] widths of way."""
    near: Tensor = (_REACH - (offset.norm(dim=-1) - CLOSE).clamp(min=0)).clamp(min=0)
    return near


def goal_place(caption: str) -> tuple[float, float] | None:
    """Returns the goal position of the first object, in object widths to the right and up of the second.

    None for a relation that a thing is not put into, such as `apart from`.
    """
    relation = next((each for each, wording in CANONICAL_WORDINGS.items() if f" {wording} " in caption), None)
    return None if relation is None else _PLACES.get(relation)


def nearness(offset: Tensor, place: tuple[float, float]) -> Tensor:
    """Returns the nearness of the first object to its goal position, float32 (...), in [0, 6] widths of way.

    Args:
        offset: Of the first object from the second, in object widths to the right and up, float32 (..., 2).
        place: Its goal position.
    """
    near: Tensor = (_REACH - way_over(offset, torch.tensor(place))).clamp(min=0)
    return near


def way_over(start: Tensor, end: Tensor) -> Tensor:
    """Returns the length of the shortest way from (..., 2) to (2,) that passes a disc at the origin over its top."""
    turn = (torch.atan2(start[..., 0], start[..., 1]) - torch.atan2(end[0], end[1])).abs()  # not below
    return way_around(start, end, turn, radius=_RADIUS)
