"""Training frames as another camera may see them, in another light and from a little aside."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from freerein.learning.augmentation import CameraTakes
from freerein.learning.encoders import FrameTensors
from freerein.types.common import Camera


@dataclass(frozen=True)
class Views:
    """How frames are seen: some as they were recorded, some augmented, each with a take of its own.

    Attributes:
        strength: Of the augmentation; 0 for none.
        share: Share of the frames that are augmented.
        generator: Source of all draws, on the CPU.
    """

    strength: float
    share: float
    generator: torch.Generator

    def of(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Returns frames as they are seen, uint8 (N, H, W, C), and by how much places in them moved, float32 (N, 2).

        Places are x and y in [-1, 1] from the left upper corner, as `torch.nn.functional.grid_sample` has them.
        """
        count, height, width, _ = frames.shape
        moved = torch.zeros((count, 2), device=frames.device)
        if not self.strength:
            return frames, moved
        which = (torch.rand(count, generator=self.generator) < self.share).nonzero()[:, 0].to(frames.device)
        takes = CameraTakes.draw(len(which), (height, width), strength=self.strength, generator=self.generator)
        seen = frames.clone()
        seen[which] = takes.of(frames[which], self.generator)
        sides = torch.tensor([width, height], device=frames.device)
        moved[which] = -2 * takes.offsets.to(frames.device).flip(1) / sides
        return seen, moved


@dataclass(frozen=True)
class SharedView:
    """One view that many frames share: what differs between two of them is what happened, and not the view.

    Attributes:
        takes: By camera, the one take of its frames; without any, frames are seen as they were recorded.
        generator: Source of noise, on the CPU.
    """

    takes: Mapping[str, CameraTakes]
    generator: torch.Generator

    @classmethod
    def draw(cls, cameras: Sequence[Camera], *, strength: float, generator: torch.Generator) -> "SharedView":
        """Returns a view of cameras; `strength` is that of the augmentation, 0 for frames as they were recorded."""
        takes = {
            each.name: CameraTakes.draw(1, (each.height, each.width), strength=strength, generator=generator)
            for each in cameras
            if strength
        }
        return cls(takes, generator)

    def of(self, frames: FrameTensors) -> FrameTensors:
        """Returns frames as they are seen, by camera: uint8 (N, H, W, C)."""
        if not self.takes:
            return frames
        return {
            camera: self.takes[camera][torch.zeros(len(each), dtype=torch.int64)].of(each, self.generator)
            for camera, each in frames.items()
        }
