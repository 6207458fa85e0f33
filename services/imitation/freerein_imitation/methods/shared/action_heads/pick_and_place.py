"""Pick and place in the plane, in bins: a location, a direction and a length (appendix A of the dissertation).

An action is x, y, dx, dy in [-1, 1], a place and a displacement. A location between the centres of cells is split
linearly among the nearest, as a length is; a direction is one of 36.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional

from freerein.types.common import ActionSpec
from freerein_imitation.methods.shared.action_bins import split

GRID, DIRECTIONS, LENGTHS = 20, 36, 10
LOCATIONS = GRID * GRID
PARTS = (LOCATIONS, DIRECTIONS, LENGTHS)

_NAMES = ("x", "y", "dx", "dy")


def picks_and_places(action: ActionSpec) -> bool:
    """Returns whether actions pick something up at x, y and lay it down at x + dx, y + dy, by their names."""
    return action.names == _NAMES and not action.choices


def encode(actions: Tensor) -> Tensor:
    """Returns actions, float32 (..., 4), as distributions of location, direction and length: float32 (..., 446)."""
    column, row = split(actions[..., 0], bins=GRID), split(actions[..., 1], bins=GRID)  # (..., GRID) each
    location = (row[..., :, None] * column[..., None, :]).flatten(-2)
    angle = torch.atan2(actions[..., 3], actions[..., 2]) / (2 * math.pi)  # turns
    direction = functional.one_hot((angle * DIRECTIONS).round().long() % DIRECTIONS, DIRECTIONS)
    length = split(2 * actions[..., 2:].norm(dim=-1).clamp(max=1) - 1, bins=LENGTHS)
    return torch.cat([location, direction.to(actions.dtype), length], dim=-1)


def decode(location: Tensor, direction: Tensor, length: Tensor) -> Tensor:
    """Returns actions, float32 (B, 4), of locations (B, 2), indices of directions (B,), and lengths in [0, 1], (B,)."""
    angle = direction * (2 * math.pi / DIRECTIONS)
    displacement = length[:, None] * torch.stack([angle.cos(), angle.sin()], dim=1)
    return torch.cat([location, displacement], dim=1).clamp(-1, 1)


def places_around(logits: Tensor, chosen: Tensor) -> Tensor:
    """Returns x and y at chosen cells, float32 (B, 2): the mean of each cell and its neighbours alone.

    `logits` are those of the locations, (B, LOCATIONS), `chosen` indices of cells, int64 (B,).
    """
    centres = torch.linspace(-1, 1, GRID, device=logits.device)
    row, column = chosen // GRID, chosen % GRID
    cells = torch.arange(GRID, device=logits.device)
    near = ((cells - row[:, None]).abs() <= 1)[:, :, None] & ((cells - column[:, None]).abs() <= 1)[:, None]
    weights = logits.masked_fill(~near.flatten(1), -math.inf).softmax(dim=1).view(-1, GRID, GRID)
    return torch.stack([weights.sum(dim=1) @ centres, weights.sum(dim=2) @ centres], dim=1)


def grid_places(device: torch.device) -> Tensor:
    """Returns x and y of the centre of each cell, float32 (LOCATIONS, 2)."""
    centres = torch.linspace(-1, 1, GRID, device=device)
    y, x = torch.meshgrid(centres, centres, indexing="ij")
    return torch.stack([x, y], dim=-1).flatten(end_dim=1)
