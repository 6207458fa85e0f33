"""Decoded timesteps of a whole dataset in one raw file, mapped into memory: training reads them at memory speed."""

import os
import secrets
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from freerein.errors import FailedPrecondition, InvalidInput

D = TypeVar("D", bound=np.generic)


@dataclass(frozen=True, eq=False)
class StepCache(Generic[D]):
    """One array over all timesteps of all trajectories, mapped read-only from disk.

    Attributes:
        steps: (N, ...), trajectory after trajectory.
        offsets: int64 (n + 1,); trajectory i is `steps[offsets[i]:offsets[i + 1]]`.
    """

    steps: npt.NDArray[D]
    offsets: npt.NDArray[np.int64]

    def __len__(self) -> int:
        """Returns the number of trajectories."""
        return len(self.offsets) - 1

    def __getitem__(self, index: int) -> npt.NDArray[D]:
        """Returns the timesteps (T, ...) of one trajectory, a view without a copy."""
        index = range(len(self))[index]
        return self.steps[self.offsets[index] : self.offsets[index + 1]]


FrameCache: TypeAlias = StepCache[np.uint8]
ActionCache: TypeAlias = StepCache[np.float32] | StepCache[np.int64]


def open_or_build(
    path: Path,
    *,
    dtype: np.dtype[D],
    shape: tuple[int, ...],
    lengths: npt.NDArray[np.int64],
    parts: Iterable[npt.NDArray[D]],
) -> StepCache[D]:
    """Returns the cache in a file, which is built first where it does not exist.

    Args:
        path: `cache/<state of the data>/<what>.raw`; other states of the data are deleted once this one is built.
        dtype: Of one number.
        shape: Of one timestep.
        lengths: int64 (n,), the timesteps of each trajectory.
        parts: The trajectories, (T, *shape) each; drawn from only to build.

    Raises:
        InvalidInput: There is no timestep to cache.
        FailedPrecondition: The disk is too small.
    """
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    if offsets[-1] == 0:
        raise InvalidInput("A dataset must hold a trajectory before it can be cached; it is empty.")
    if not path.is_file():
        _build(path, parts, size=int(offsets[-1]) * int(np.prod(shape)) * dtype.itemsize)
        _delete_other_states(path.parent)
    return StepCache(np.memmap(path, dtype, mode="r", shape=(int(offsets[-1]), *shape)), offsets)


def _build(path: Path, parts: Iterable[npt.NDArray[D]], *, size: int) -> None:
    """Writes beside the file and renames, so that a cache is whole or absent, whoever else builds it meanwhile."""
    path.parent.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(path.parent).free
    if free < size:
        raise FailedPrecondition(
            f"The decoded dataset takes {size / 1e9:.1f} GB of disk; {free / 1e9:.1f} GB are free.",
            hint="Free some space where the dataset lies.",
        )
    unfinished = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
    try:
        with unfinished.open("wb") as file:
            file.writelines(np.ascontiguousarray(part).data for part in parts)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def _delete_other_states(current: Path) -> None:
    for state in current.parent.iterdir():
        if state != current:
            shutil.rmtree(state)
