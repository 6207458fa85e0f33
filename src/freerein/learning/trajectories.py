"""Arrays stored per trajectory, as learners read them."""

from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt

D_co = TypeVar("D_co", bound=np.generic, covariant=True)


class TrajectoryArrays(Protocol[D_co]):
    """One array (T, ...) per trajectory: a list of arrays, or `freerein.data.cache.StepCache`."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> npt.NDArray[D_co]: ...


def sample_frames(frames: TrajectoryArrays[np.uint8], count: int) -> npt.NDArray[np.uint8]:
    """Returns about `count` frames, uint8 (N, H, W, C), spaced evenly over all trajectories."""
    every = max(1, sum(len(frames[item]) for item in range(len(frames))) // count)
    return np.concatenate([frames[item][item % every :: every] for item in range(len(frames))])
