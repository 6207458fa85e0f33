"""Files that are whole or absent after a crash, and the lock that keeps a dataset to one writer."""

import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import Self

from freerein.errors import FailedPrecondition

UNFINISHED = ".tmp"


def write_durably(path: Path, data: bytes) -> None:
    """Writes a file so that it survives a crash whole, or not at all: beside it, fsync, rename, fsync of the folder."""
    _make_folder(path.parent)
    unfinished = path.with_name(path.name + UNFINISHED)
    with unfinished.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Makes renames and deletions in a folder durable."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _make_folder(folder: Path) -> None:
    if not folder.is_dir():
        _make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        sync_folder(folder.parent)


class WriterLock:
    """Held by the one process that may write to a dataset; the kernel frees it when that process dies.

    Raises:
        FailedPrecondition: Someone else holds it.
    """

    def __init__(self, root: Path) -> None:
        self._descriptor = os.open(root / "writer.lock", os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._descriptor)
            raise FailedPrecondition(
                "A dataset has one writer at a time; this one is being written by another.",
                hint="Close the other writer, or write to another dataset.",
            ) from None

    def release(self) -> None:
        """Lets others write. To release twice is an error."""
        os.close(self._descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.release()
