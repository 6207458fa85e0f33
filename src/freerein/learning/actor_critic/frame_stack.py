"""Frame stacks: an observation is the last k frames of one or several cameras, on the channels (Mnih et al. 2015).

A single frame tells no velocity. Where an episode starts, its first frame stands for those before it, too.
"""

import torch
from torch import Tensor

_LUMA = (299, 587, 114)
"""Weights of red, green and blue in ITU-R BT.601, in thousandths."""


def stack_frames(frames: Tensor, earlier: Tensor, starts: Tensor) -> Tensor:
    """Returns the last k frames of N environments, oldest first, uint8 (N, H, W, C * k).

    Args:
        frames: The newest, uint8 (N, H, W, C).
        earlier: Those before it, oldest first, uint8 (N, H, W, C * (k - 1)).
        starts: Whether an episode starts with the newest, bool (N,).
    """
    count = earlier.shape[-1] // frames.shape[-1]
    if not count:
        return frames
    before = torch.where(starts[:, None, None, None], frames.repeat(1, 1, 1, count), earlier)
    return torch.cat([before, frames], dim=-1)


def luma(frames: Tensor) -> Tensor:
    """Returns the luma of RGB frames of V cameras, uint8 (N, H, W, 3 * V) to (N, H, W, V); whole numbers alone."""
    red, green, blue = (frames[..., channel::3].int() * weight for channel, weight in enumerate(_LUMA))
    return ((red + green + blue + 500) // 1000).to(torch.uint8)
