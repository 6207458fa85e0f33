"""Distractors: shapes in front of a scene that no phrase names, some in the colours of the objects that phrases name.

Unlike those of `freerein.learning.augmentation`, they cover no object, so that keypoints and captions stay true. Images
say nothing of what a phrase does not name: a red ball beside a red block is as red as the block.
"""

import torch
from torch import Tensor

_MOST, _SHARE = 3, 0.7
_LEAST_SIDE, _MOST_SIDE = 0.05, 0.25
"""Most distractors in a frame, the share of frames that have each, and their sides, as shares of the frame's."""

_ROUND, _OWN_COLOUR = 0.7, 0.7
"""Share of round ones, and the share of those that has the colour of an object. Square ones with it might be blocks."""

_OWN_SIZE, _ABOUT = 0.5, (0.7, 1.5)
"""Share of the round ones that are about as large as an object, and their sides as shares of the object's."""

_LIGHT_AT, _DARKENING = 0.5, 0.4
"""Largest distance of the brightest point of a shaded one from its middle, and its loss of brightness one away from
there, both in half sides."""


def add_distractors(
    frames: Tensor,
    keypoints: Tensor,
    is_kept: Tensor,
    *,
    clearance: Tensor,
    strength: float,
    generator: torch.Generator,
) -> Tensor:
    """Returns frames with up to three ellipses and rectangles, each of one colour, half of the ellipses shaded.

    Args:
        frames: uint8 (N, H, W, 3).
        keypoints: float (N, P, 2), x and y of things as fractions; those of `is_kept` are not covered.
        is_kept: bool (N, P).
        clearance: Half the size of a thing as fractions of width and height, float (2,).
        strength: 0 for none, 1 for a share of 0.7 of the frames for each.
        generator: Source of all draws, on the CPU.
    """
    count, height, width, _ = frames.shape
    palette = colours_at(frames, keypoints, is_kept)
    across, down = (torch.arange(width) + 0.5) / width, (torch.arange(height) + 0.5) / height
    for _ in range(_MOST):
        centres, bright = torch.rand((2, count, 2), generator=generator)
        is_round, is_own, is_shaded, is_wanted = _coins(count, strength, generator)
        sides = _sides(is_round, 2 * clearance, generator)
        covers = ((keypoints - centres[:, None]).abs() < (sides / 2)[:, None] + clearance).all(dim=2) & is_kept
        is_there = is_wanted & ~covers.any(dim=1)
        colours = _colours(count, palette, is_round & is_own, generator)
        x = (across - centres[:, 0, None]) / (sides[:, 0, None] / 2)  # (N, W), in half sides
        y = (down - centres[:, 1, None]) / (sides[:, 1, None] / 2)
        radius = x[:, None].square() + y[:, :, None].square()  # (N, H, W)
        square = torch.maximum(x[:, None].abs(), y[:, :, None].abs())
        covered = (torch.where(is_round[:, None, None], radius, square) <= 1) & is_there[:, None, None]
        at = (2 * bright - 1) * _LIGHT_AT  # (N, 2)
        distance = (x - at[:, :1])[:, None].square() + (y - at[:, 1:])[:, :, None].square()  # (N, H, W)
        light = (1 - _DARKENING * distance * (is_round & is_shaded)[:, None, None]).clamp(min=0)
        drawn = (colours[:, None, None] * light[..., None]).to(torch.uint8)
        frames = torch.where(covered[..., None], drawn, frames)
    return frames


def colours_at(frames: Tensor, keypoints: Tensor, is_kept: Tensor) -> Tensor:
    """Returns the colours of things at keypoints, float32 (K, 3); arguments are as of `add_distractors`."""
    sides = torch.tensor([frames.shape[2], frames.shape[1]])
    columns, rows = (keypoints * sides).long().clamp(min=0).minimum(sides - 1).unbind(dim=2)  # (N, P)
    numbers = torch.arange(len(frames))[:, None].expand_as(rows)
    return frames[numbers[is_kept], rows[is_kept], columns[is_kept]].float()


def _sides(is_round: Tensor, own: Tensor, generator: torch.Generator) -> Tensor:
    """Returns width and height of distractors as fractions, float (N, 2); `own`, (2,), are those of an object."""
    count = len(is_round)
    anything = _LEAST_SIDE + (_MOST_SIDE - _LEAST_SIDE) * torch.rand((count, 2), generator=generator)
    least, most = _ABOUT
    about = own * (least + (most - least) * torch.rand((count, 1), generator=generator))
    is_about = is_round & (torch.rand(count, generator=generator) < _OWN_SIZE)
    return torch.where(is_about[:, None], about, anything)


def _coins(count: int, strength: float, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Returns whether each distractor is round, of an object's colour, shaded, and wanted: bool (N,) each."""
    drawn = torch.rand((4, count), generator=generator)
    is_round, is_own, is_shaded, is_wanted = (
        drawn < torch.tensor([_ROUND, _OWN_COLOUR, 0.5, strength * _SHARE])[:, None]
    )
    return is_round, is_own, is_shaded, is_wanted


def _colours(count: int, palette: Tensor, is_own: Tensor, generator: torch.Generator) -> Tensor:
    """Returns colours, float32 (N, 3): of the palette (K, 3) where `is_own`, else any."""
    any_colour = 255 * torch.rand((count, 3), generator=generator)
    if not len(palette):
        return any_colour
    chosen = palette[torch.randint(len(palette), (count,), generator=generator)]
    return torch.where(is_own[:, None], chosen, any_colour)
