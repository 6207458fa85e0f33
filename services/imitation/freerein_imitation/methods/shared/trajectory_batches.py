"""Timesteps of several trajectories in one batch, and the action executed before each."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor


def joined(parts: Sequence[npt.NDArray[Any]], device: torch.device) -> Tensor:
    """Returns arrays (n, ...), one after the other, as a tensor (N, ...)."""
    return torch.from_numpy(np.concatenate(parts)).to(device)


def previous_actions(actions: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Returns the action before each of `actions`, float32 (T, A) or int64 (T, 1); 0, or -1 when discrete, at first."""
    none = np.full_like(actions[:1], -1 if np.issubdtype(actions.dtype, np.integer) else 0)
    return np.concatenate([none, actions[:-1]])
