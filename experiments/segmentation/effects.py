"""Effects on a camera after a fit: less light, and a push."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from freerein.learning.trajectories import Trajectories, TrajectoryArrays

Frames = npt.NDArray[np.uint8]
Effect = Callable[[Frames], Frames]

_PIXELS = 3


def _dimmed(light: float) -> Effect:
    dimmed = np.rint(light * np.arange(256)).astype(np.uint8)
    return lambda frames: dimmed[frames]


def _pushed(frames: Frames) -> Frames:
    columns = np.minimum(np.arange(frames.shape[2]) + _PIXELS, frames.shape[2] - 1)
    return frames[:, :, columns]


EFFECTS: Mapping[str, Effect] = MappingProxyType(
    {"light-0.8": _dimmed(0.8), "light-0.6": _dimmed(0.6), "aside-3px": _pushed}
)
"""Effects on frames, uint8 (N, H, W, C), by name."""


@dataclass(frozen=True)
class _Changed:
    frames: TrajectoryArrays[np.uint8]
    effect: Effect

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int, /) -> Frames:
        return self.effect(self.frames[index])


def under(effect: Effect, seen: Trajectories) -> Trajectories:
    """Returns trajectories whose frames are changed as they are read."""
    return replace(seen, frames={camera: _Changed(frames, effect) for camera, frames in seen.frames.items()})
