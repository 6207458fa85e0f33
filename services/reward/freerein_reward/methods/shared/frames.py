"""Frames of a dataset as the grounding model sees them."""

import numpy as np
import numpy.typing as npt

from freerein_reward.model import preprocess


def resized(frames: npt.NDArray[np.uint8], size: int) -> npt.NDArray[np.uint8]:
    """Returns frames (N, H, W, C) as uint8 (N, size, size, 3), without a copy where they have that shape."""
    if frames.shape[1:] == (size, size, 3):
        return frames
    return np.stack([preprocess(frame, size=size) for frame in frames])
