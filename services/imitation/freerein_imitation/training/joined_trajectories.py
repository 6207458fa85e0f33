"""Timesteps of several trajectories in one batch, trajectory after trajectory."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor


def joined(parts: Sequence[npt.NDArray[Any]], device: torch.device) -> Tensor:
    """Returns arrays (n, ...), one after the other, as a tensor (N, ...)."""
    return torch.from_numpy(np.concatenate(parts)).to(device)
