"""How much memory a fit of segmentation takes: it grows with the frames of a batch."""

import math

import numpy as np
import numpy.typing as npt

from freerein.data.tag_checks import Problem

MOST_NUMBERS = 2**27
"""Most numbers of frames that a fit holds at once: height x width x channels of each frame of a batch.

For each number a fit takes up to 30 bytes, 4 GB in all: measured on the CPU with augmentation and the encoder `patch`,
in frames of 480 x 640 x 3, with which it is most.
"""

DEFAULT_BATCH_SIZE = 8
"""Trajectories of a batch of a fit of segmentation, by default."""


def batch_problems(
    lengths: npt.NDArray[np.int64],
    frame: tuple[int, int, int],
    *,
    batch_size: int = DEFAULT_BATCH_SIZE,
    stride: int = 1,
    cost: float = 1.0,
) -> list[Problem]:
    """Returns a warning where a batch of the longest trajectories takes too much memory.

    Args:
        lengths: int64 (n,), timesteps of each trajectory.
        frame: Height, width and channels of a frame.
        batch_size: Trajectories of a batch.
        stride: Every such timestep is in a batch.
        cost: Memory of the encoder, relative to that of `patch`.
    """
    timesteps = int(np.sum(-(-np.sort(lengths)[-batch_size:] // stride)))
    numbers, most = timesteps * math.prod(frame), int(MOST_NUMBERS / cost)
    if numbers <= most:
        return []
    sentence = (
        f"The frames of a batch of {batch_size} trajectories must have at most {most / 1e6:.0f} million numbers "
        f"(height x width x channels), with which a fit takes 4 GB; those of the longest have {numbers / 1e6:.0f} "
        "million."
    )
    hint = "Import smaller frames, freerein dataset import FOLDER NAME --size HxW, or set a smaller batch_size."
    return [Problem("frames", sentence, hint, "warning")]
