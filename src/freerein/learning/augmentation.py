"""Augmentation of images by what cameras and light do: brightness, colour temperature, hue, small shifts, noise.

What an image shows stays what it was, and so do its labels: this adds no supervision.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import torch
from torch import Tensor
from torch.nn import functional

_LIGHT = 1.6
"""Largest factor of the brightness, and of its inverse."""

_TEMPERATURE, _TINT = 0.18, 0.05
"""Largest relative change of red against blue, and of green."""

_HUE_TURN = 0.11
"""Largest turn of all hues, as a share of the colour circle. The background turns with the objects, so that what was
red still differs from what was yellow; a turn of twice as much would make green of yellow."""

_SHIFT = 0.11
"""Largest shift along each axis, as a share of the frame."""

_NOISE = 0.1
"""Largest standard deviation of a pixel's noise, as a share of the range of its values; half of the takes have none."""

_DISTRACTORS, _DISTRACTOR_SHARE = 3, 0.7
_LEAST_SIDE, _MOST_SIDE = 0.04, 0.2
"""Most distractors in a frame, the share of frames that have each, and their sides, as shares of the frame's."""

_FRAMES_AT_ONCE, _FRAMES_IN_CACHE = 256, 32
"""Frames whose noise is drawn at once, a multiple of those that are computed at once."""

_CROP_AREA, _CROP_ASPECT = (0.95, 1.0), (0.98, 1.02)
"""Area of a crop as a share of the frame's, and its width by its height (section 4.3)."""

_BEGIN = 0.4
"""Share of a fit's steps before the first augmented ones."""


@dataclass(frozen=True)
class CameraTakes:
    """How other cameras see a scene, in other lights: N takes.

    Attributes:
        offsets: Rows and columns by which frames are moved up and left, in pixels, int64 (N, 2).
        turns: Of all hues, as shares of the colour circle, float32 (N,).
        gains: Of red, green and blue, float32 (N, 3).
        light: Factors of the brightness, float32 (N,).
        sigma: Standard deviations of the noise, as shares of the range of values, float32 (N,).
    """

    offsets: Tensor
    turns: Tensor
    gains: Tensor
    light: Tensor
    sigma: Tensor

    @classmethod
    def draw(
        cls,
        count: int,
        frame_size: Sequence[int],
        *,
        strength: float,
        generator: torch.Generator,
    ) -> "CameraTakes":
        """Returns takes of frames of height and width `frame_size`; `strength` is as of `augment_camera`."""

        def draw(*sizes: int) -> Tensor:  # uniform in [-strength, strength], float32 (N, *sizes)
            return strength * (2 * torch.rand((count, *sizes), generator=generator) - 1)

        scale = torch.tensor([_SHIFT * side for side in frame_size])
        offsets, turns = (scale * draw(2)).round().long(), _HUE_TURN * draw()
        warmth, tint = draw(), draw()
        gains = torch.stack([1 + _TEMPERATURE * warmth, 1 + _TINT * tint, 1 - _TEMPERATURE * warmth], dim=1)
        light = torch.exp(math.log(_LIGHT) * draw())
        return cls(offsets, turns, gains, light, _NOISE * draw().clamp(min=0))

    def of(self, frames: Tensor, generator: torch.Generator) -> Tensor:
        """Returns frames, uint8 (N, H, W, C), each as its take has it; `generator` is the source of noise."""
        takes = CameraTakes(*(getattr(self, each.name).to(frames.device) for each in fields(self)))
        seen = torch.empty_like(frames)
        for start in range(0, len(frames), _FRAMES_AT_ONCE):
            noise = torch.randn(frames[start : start + _FRAMES_AT_ONCE].shape, generator=generator).to(frames.device)
            for first in range(0, len(noise), _FRAMES_IN_CACHE):
                at = slice(start + first, start + first + _FRAMES_IN_CACHE)
                seen[at] = takes[at]._seen(frames[at], noise[first : first + _FRAMES_IN_CACHE])
        return seen

    def _seen(self, frames: Tensor, noise: Tensor) -> Tensor:
        """Returns a few frames as their takes have them: colour by colour, which is faster than pixel by pixel."""
        planes = shift(frames, self.offsets).permute(3, 0, 1, 2).contiguous().float().div_(255)  # (C, N, H, W)
        if len(planes) == 3:
            planes = turn_hue(planes, self.turns).mul_(self.gains.T[:, :, None, None])
        planes.mul_(self.light[:, None, None]).add_(noise.permute(3, 0, 1, 2) * self.sigma[:, None, None])
        return planes.mul_(255).round_().clamp_(0, 255).to(torch.uint8).permute(1, 2, 3, 0)

    def __getitem__(self, which: Tensor | slice) -> "CameraTakes":
        """Returns some of the takes, by number, int64 (M,), or a slice of them."""
        return CameraTakes(*(getattr(self, each.name)[which] for each in fields(self)))


def augment_camera(frames: Tensor, takes: Tensor, *, strength: float, generator: torch.Generator) -> Tensor:
    """Returns frames as another camera would have seen them, in another light.

    Args:
        frames: uint8 (N, H, W, C), C = 1 or 3.
        takes: int64 (N,), which take each frame is of, from 0 on. Frames of one take share all but the noise's values.
        strength: 0 for none, 1 for the whole ranges of this module.
        generator: Source of all draws, on the CPU.

    Returns:
        uint8 (N, H, W, C), on the device of `frames`.
    """
    if not strength or not len(frames):
        return frames
    count = int(takes.max()) + 1
    drawn = CameraTakes.draw(count, frames.shape[1:3], strength=strength, generator=generator)
    return drawn[takes.cpu()].of(frames, generator)


def add_distractors(frames: Tensor, *, strength: float, generator: torch.Generator) -> Tensor:
    """Returns frames with rectangles in front, each of one colour: things that a fit is not about.

    Args:
        frames: uint8 (N, H, W, C).
        strength: 0 for none, 1 for up to three in a frame.
        generator: Source of all draws, on the CPU.
    """
    count, height, width, channels = frames.shape
    rows, columns = torch.arange(height)[:, None] / height, torch.arange(width) / width
    for _ in range(_DISTRACTORS):
        sides = _LEAST_SIDE + (_MOST_SIDE - _LEAST_SIDE) * torch.rand((2, count, 1, 1), generator=generator)
        top, left = torch.rand((2, count, 1, 1), generator=generator) - sides / 2
        colours = (256 * torch.rand((count, 1, 1, channels), generator=generator)).to(torch.uint8)
        is_there = torch.rand((count, 1, 1), generator=generator) < strength * _DISTRACTOR_SHARE
        is_inside = (rows >= top) & (rows < top + sides[0]) & (columns >= left) & (columns < left + sides[1])
        covered = (is_inside & is_there)[..., None].to(frames.device)
        frames = torch.where(covered, colours.to(frames.device), frames)
    return frames


def resized_crops(frames: Tensor, *, generator: torch.Generator) -> Tensor:
    """Returns a random crop of each frame, uint8 (N, H, W, C), enlarged to the frame's size: RandomResizedCrop.

    Areas are uniform and aspects log-uniform (section 4.3). Pixels are interpolated bilinearly.

    Args:
        frames: uint8 (N, H, W, C).
        generator: Source of all draws, on the CPU.
    """
    area, aspect, *place = torch.rand((4, len(frames)), generator=generator)
    area = _CROP_AREA[0] + (_CROP_AREA[1] - _CROP_AREA[0]) * area
    least, most = map(math.log, _CROP_ASPECT)
    aspect = torch.exp(least + (most - least) * aspect)
    sides = torch.stack([(area * aspect).sqrt(), (area / aspect).sqrt()], dim=1).clamp(max=1)  # width, height
    centres = (1 - sides) * (2 * torch.stack(place, dim=1) - 1)  # in frames 2 wide
    transforms = torch.cat([torch.diag_embed(sides), centres[:, :, None]], dim=2).to(frames.device)
    pixels = frames.permute(0, 3, 1, 2).float()
    grid = functional.affine_grid(transforms, list(pixels.shape), align_corners=False)
    cropped = functional.grid_sample(pixels, grid, padding_mode="border", align_corners=False)
    return cropped.round_().clamp_(0, 255).to(torch.uint8).permute(0, 2, 3, 1).contiguous()


def delayed(strength: float, *, step: int, steps: int) -> float:
    """Returns the strength at an optimiser step: 0 in the first two fifths of a fit, then the whole.

    What frames show is found before what does not matter: while the fit is still separating skills, agreement makes the
    network sure of what it has confused so far.
    """
    return strength if step >= _BEGIN * steps else 0.0


def agreement(scores: Tensor, teacher: Tensor) -> Tensor:
    """Returns the mean cross-entropy of scores (..., K) against a teacher's scores (..., K) of the same scenes.

    The teacher saw the frames as they are, and is not trained by this: what is seen badly learns from what is seen well
    (Xie et al., "Unsupervised data augmentation for consistency training", 2020).
    """
    classes = scores.shape[-1]
    probabilities = teacher.detach().reshape(-1, classes).softmax(dim=1)
    return functional.cross_entropy(scores.reshape(-1, classes), probabilities)


def turn_hue(planes: Tensor, turns: Tensor) -> Tensor:
    """Returns the planes of RGB images, float (3, N, H, W), with hues turned; HSV value and saturation stay.

    Signs of differences, 0 or 1, choose between the sectors of the colour circle: on a CPU comparisons, and remainders,
    take several times as long as arithmetic.

    Args:
        planes: Red, green and blue.
        turns: Shares of the colour circle, float (N,).
    """
    red, green, blue = planes
    value = torch.maximum(torch.maximum(red, green), blue)  # (N, H, W)
    chroma = value - torch.minimum(torch.minimum(red, green), blue)
    other_than_red, other_than_green = (value - red).sign_(), (value - green).sign_()
    difference = (blue - red) * (1 - other_than_green) + (red - green) * other_than_green
    difference = (green - blue) * (1 - other_than_red) + difference * other_than_red
    sector = difference / (chroma + (1 - chroma.sign())) + (2 + 2 * other_than_green) * other_than_red
    sector += 6 * turns[:, None, None]
    turned = []
    for start in (5, 3, 1):
        phase = start + sector
        phase -= 6 * (phase / 6).floor_()
        turned.append(value - torch.minimum(phase, 4 - phase).clamp_(0, 1).mul_(chroma))
    return torch.stack(turned)


def shift(frames: Tensor, offsets: Tensor) -> Tensor:
    """Returns frames moved up and left by whole pixels, edges replicated.

    Args:
        frames: (N, H, W, C).
        offsets: Rows and columns, int64 (N, 2); negative ones move down and right.
    """
    count, height, width, _ = frames.shape
    rows = (torch.arange(height, device=frames.device) + offsets[:, :1]).clamp(0, height - 1)  # (N, H)
    columns = (torch.arange(width, device=frames.device) + offsets[:, 1:]).clamp(0, width - 1)  # (N, W)
    first = height * torch.arange(count, device=frames.device)[:, None]
    pixels = width * (first + rows)[:, :, None] + columns[:, None]  # (N, H, W)
    return frames.flatten(0, 2).index_select(0, pixels.flatten()).view(frames.shape)
