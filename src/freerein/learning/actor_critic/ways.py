"""Lengths of ways around a disc at the origin, for potentials of what cannot pass through a thing."""

import torch
from torch import Tensor


def way_around(start: Tensor, end: Tensor, turn: Tensor, *, radius: float) -> Tensor:
    """Returns the length of the shortest way that passes the disc: two tangents and an arc, or straight on.

    Args:
        start: float32 (..., 2); a place within the disc is taken for one on its rim.
        end: The same, or one for all, float32 (2,).
        turn: Angle by which the way turns about the origin, in radians, (...).
        radius: Of the disc.
    """
    far, near = start.norm(dim=-1).clamp(min=radius), end.norm(dim=-1).clamp(min=radius)
    arc = turn - torch.acos(radius / far) - torch.acos(radius / near)
    around = (far**2 - radius**2).sqrt() + (near**2 - radius**2).sqrt() + radius * arc
    return torch.where(arc > 0, around, (start - end).norm(dim=-1))


def angle_between(first: Tensor, second: Tensor) -> Tensor:
    """Returns the angle between vectors float32 (..., 2) and (..., 2), in [0, pi], (...)."""
    across = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    return torch.atan2(across.abs(), (first * second).sum(dim=-1))
