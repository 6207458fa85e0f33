"""Decoded timesteps of a whole dataset in one raw file, mapped into memory."""

import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from freerein.data.folder_locks import in_use, unused
from freerein.errors import InvalidInput, OutOfStorage

D = TypeVar("D", bound=np.generic)

_FINGERPRINT = "[0-9a-f]" * 16
_FILE = re.compile(r"(actions|terminations|frames-.+)\.raw(\.[0-9a-f]{8})?")
"""Names of our files, and of those that are being built: people may have others beside them."""


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
        path: `cache/<fingerprint>/<name>.raw`; files of other fingerprints are deleted after a build, unless one is
            being built among them.
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
            for other in unused_folders(path.parent.parent):  # the file's own is in use
                delete_cached(other)
        return StepCache(np.memmap(path, dtype, mode="r", shape=(int(offsets[-1]), *shape)), offsets)


def unused_folders(cache: Path) -> Iterator[Path]:
    """Yields the folders of a dataset's cache that no process uses, as `unused`; links are not followed."""
    return unused(each for each in cache.glob(_FINGERPRINT) if not each.is_symlink())


def delete_cached(folder: Path) -> int:
    """Deletes the cached files in a folder, and the folder unless it holds others; returns the bytes."""
    freed = 0
    for file in _cached_files(folder):
        freed += file.stat().st_size
        file.unlink()
    with suppress(OSError):  # other files are left
        folder.rmdir()
    return freed


def _cached_files(folder: Path) -> list[Path]:
    return [each for each in folder.iterdir() if _FILE.fullmatch(each.name) and stat.S_ISREG(each.lstat().st_mode)]


def _delete_abandoned(cache: Path) -> None:
    """Deletes the files that killed processes were building."""
    for folder in unused_folders(cache):
        for unfinished in (each for each in _cached_files(folder) if each.suffix != ".raw"):
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
