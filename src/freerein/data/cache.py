"""Decoded timesteps of a whole dataset in one raw file, mapped into memory."""

import os
import secrets
import shutil
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from freerein.data.folder_locks import in_use, unused
from freerein.errors import InvalidInput, OutOfStorage

D = TypeVar("D", bound=np.generic)


@dataclass(frozen=True, eq=False)
class StepCache(Generic[D]):
    """The timesteps of all trajectories as one array, mapped read-only from disk.

    Attributes:
        steps: (N, ...), the trajectories concatenated.
        offsets: int64 (n + 1,); trajectory i is `steps[offsets[i]:offsets[i + 1]]`.
    """

    steps: npt.NDArray[D]
    offsets: npt.NDArray[np.int64]

    def __len__(self) -> int:
        """Returns the number of trajectories."""
        return len(self.offsets) - 1

    def __getitem__(self, index: int) -> npt.NDArray[D]:
        """Returns the timesteps (T, ...) of one trajectory, as a view."""
        index = range(len(self))[index]
        return self.steps[self.offsets[index] : self.offsets[index + 1]]


def open_or_build(
    path: Path,
    *,
    dtype: np.dtype[D],
    shape: tuple[int, ...],
    lengths: npt.NDArray[np.int64],
    parts: Iterable[npt.NDArray[D]],
) -> StepCache[D]:
    """Returns the cache of a file, building the file if it does not exist.

    Args:
        path: `cache/<fingerprint>/<name>.raw`; folders of other fingerprints are deleted after a build, unless one is
            being built in.
        dtype: Of the array.
        shape: Shape of one timestep.
        lengths: int64 (n,), timesteps of each trajectory.
        parts: The trajectories, (T, *shape) each; iterated only to build.
    """
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    if offsets[-1] == 0:
        raise InvalidInput("A dataset must hold a trajectory before it can be cached; it is empty.")
    if not path.is_file():
        _delete_abandoned(path.parent.parent)
    with in_use(path.parent):
        if not path.is_file():
            _build(path, parts, size=int(offsets[-1]) * int(np.prod(shape)) * dtype.itemsize)
            for other in unused(each for each in path.parent.parent.iterdir() if each != path.parent):
                shutil.rmtree(other, ignore_errors=True)
        return StepCache(np.memmap(path, dtype, mode="r", shape=(int(offsets[-1]), *shape)), offsets)


def _delete_abandoned(cache: Path) -> None:
    """Deletes the files that killed processes were building."""
    for folder in unused(cache.glob("*")):
        for unfinished in (each for each in folder.iterdir() if each.suffix != ".raw"):
            with suppress(OSError):
                unfinished.unlink()


def _build(path: Path, parts: Iterable[npt.NDArray[D]], *, size: int) -> None:
    """Writes to a temporary file and renames it, so that concurrent builds are safe."""
    free = shutil.disk_usage(path.parent).free
    if free < size:
        raise OutOfStorage(
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
