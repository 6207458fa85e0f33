"""The batches of a fit of segmentation: the memory and the minutes that they take, and which are held in memory."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from freerein.data.input_bounds import smaller_sizes
from freerein.data.tag_checks import Problem

MOST_NUMBERS = 2**27
"""Most numbers of frames that a fit holds at once: height x width x channels of each frame of a batch.

For each number a fit takes up to 30 bytes, 4 GB in all: measured on the CPU with augmentation and the encoder `patch`,
in frames of 480 x 640 x 3, with which it is most.
"""

DEFAULT_BATCH_SIZE = 8
"""Trajectories of a batch of a fit of segmentation, by default."""

DEFAULT_STEPS = 2000
"""Optimiser steps of such a fit, by default."""

_BYTES_PER_NUMBER = 30
_S_PER_TIMESTEP, _S_PER_NUMBER = 80e-6, 9e-9
_MOST_STRIDE = 100


@dataclass(frozen=True, eq=False)
class Batches:
    """The batches of a fit of segmentation.

    Attributes:
        lengths: int64 (n,), timesteps of each trajectory.
        frame: Height, width and channels of a frame.
        size: Trajectories of a batch.
        stride: Every such timestep is in a batch.
        cost: Memory of the encoder, relative to that of `patch`.
    """

    lengths: npt.NDArray[np.int64]
    frame: tuple[int, int, int]
    size: int = DEFAULT_BATCH_SIZE
    stride: int = 1
    cost: float = 1.0

    @property
    def numbers(self) -> int:
        """Numbers of the frames of a batch of the longest trajectories."""
        return int(np.sum(np.sort(self._timesteps)[-self.size :])) * math.prod(self.frame)

    @property
    def most_numbers(self) -> int:
        """How many they may be."""
        return int(MOST_NUMBERS / self.cost)

    @property
    def are_held(self) -> bool:
        """Whether a fit holds them in memory; it refuses others."""
        return self.numbers <= self.most_numbers

    @property
    def memory_bytes(self) -> float:
        """Bytes that a fit takes at most for the frames of a batch; 4 GB where they are as many as they may be."""
        return self.numbers * self.cost * _BYTES_PER_NUMBER

    def seconds(self, steps: int = DEFAULT_STEPS) -> float:
        """Returns about how long optimiser steps take on one core of a CPU, with the encoder `patch`.

        It is a plain estimate: 80 us for each timestep of a batch of average trajectories, and 9 ns for each number of
        its frames. It was within a quarter of what was measured in frames of 48 x 64 to 480 x 640.
        """
        timesteps = min(self.size, len(self._timesteps)) * float(self._timesteps.mean())
        return steps * timesteps * (_S_PER_TIMESTEP + _S_PER_NUMBER * math.prod(self.frame))

    @property
    def _timesteps(self) -> npt.NDArray[np.int64]:
        return -(-self.lengths // self.stride)


def batch_problems(batches: Batches, *, dataset: str) -> list[Problem]:
    """Returns an error where a batch of the longest trajectories takes too much memory; its hint has what works.

    `dataset` is the name of the dataset.
    """
    if batches.are_held:
        return []
    sentence = (
        f"The frames of a batch of {batches.size} trajectories must have at most "
        f"{batches.most_numbers / 1e6:.0f} million numbers (height x width x channels), with which a fit takes 4 GB; "
        f"those of the longest have {batches.numbers / 1e6:.0f} million."
    )
    return [Problem("frames", sentence, " ".join(_ways_out(batches, dataset)))]


def _ways_out(batches: Batches, dataset: str) -> Iterator[str]:
    """Yields sentences with the commands that work."""
    smaller = [replace(batches, frame=(*size, batches.frame[2])) for size in smaller_sizes(batches.frame)]
    held = next((each for each in smaller if each.are_held), smaller[-1] if smaller else batches)
    if smaller:
        height, width, _ = held.frame
        command = f"freerein dataset import FOLDER {dataset} --replace --size {height}x{width}"
        yield f"Import smaller frames: `{command}`."
    if not held.are_held:
        strides = range(held.stride + 1, _MOST_STRIDE + 1)
        stride = next((each for each in strides if replace(held, stride=each).are_held), _MOST_STRIDE)
        yield f"Learn from one timestep in {stride}: `freerein fit segmentation {dataset} --set stride={stride}`."
    size = next((size for size in range(batches.size, 0, -1) if replace(batches, size=size).are_held), 0)
    if size:
        strided = f" --set stride={batches.stride}" if batches.stride > 1 else ""
        yield f"Or smaller batches: `freerein fit segmentation {dataset} --set batch_size={size}{strided}`."
