"""Nearness of an object to its goal position beside another, from the keypoints of both.

Objects do not pass through each other: the way to the other side leads over the top.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from freerein.relations import CANONICAL_WORDINGS, SpatialRelation

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
    far, near = start.norm(dim=-1).clamp(min=_RADIUS), end.norm().clamp(min=_RADIUS)
    turn = (torch.atan2(start[..., 0], start[..., 1]) - torch.atan2(end[0], end[1])).abs()  # about the origin
    arc = turn - torch.acos(_RADIUS / far) - torch.acos(_RADIUS / near)
    around = (far**2 - _RADIUS**2).sqrt() + (near**2 - _RADIUS**2).sqrt() + _RADIUS * arc
    return torch.where(arc > 0, around, (start - end).norm(dim=-1))
