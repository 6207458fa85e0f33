"""Files of JSON lines that are appended to and read at the same time. A line torn by a crash is never read."""

import fcntl
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

_TAIL_BYTES = 1 << 16  # longer than any line
_READ_BYTES = 1 << 20


class Appender:
    """Appends to a file under an exclusive lock.

    Args:
        descriptor: The locked file, open for reading and appending.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def last(self) -> dict[str, Any] | None:
        """Returns the last document; None for an empty file."""
        return _last(self._descriptor)

    def append(self, documents: Iterable[Mapping[str, Any]]) -> None:
        """Appends documents durably.

        Raises:
            OSError: The disk is full or broken.
        """
        data = b"".join(json.dumps(document).encode() + b"\n" for document in documents)
        while data:
            data = data[os.write(self._descriptor, data) :]
        os.fsync(self._descriptor)


@contextmanager
def appending(path: Path) -> Iterator[Appender]:
    """Yields what appends to a file while no other process does; cuts off a torn last line first."""
    descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        if torn := len(_tail(descriptor).rpartition(b"\n")[2]):
            os.ftruncate(descriptor, os.fstat(descriptor).st_size - torn)
        yield Appender(descriptor)
    finally:
        os.close(descriptor)


def last_document(path: Path) -> dict[str, Any] | None:
    """Returns the last document of a file; None for an empty one."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        return _last(descriptor)
    finally:
        os.close(descriptor)


class LineReader:
    """Reads each line once while others append; starts again when the file is replaced.

    Args:
        path: The file; it may not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._inode = self._offset = 0

    def read(self) -> list[dict[str, Any]]:
        """Returns the next documents, at most 1 MiB of them; empty when there are no new ones."""
        if not self._path.is_file():
            return []
        with self._path.open("rb") as file:
            self._follow(os.fstat(file.fileno()).st_ino, file)
            whole, newline, _ = file.read(_READ_BYTES).rpartition(b"\n")
        self._offset += len(whole) + len(newline)
        return [json.loads(line) for line in whole.splitlines()]

    def _follow(self, inode: int, file: BinaryIO) -> None:
        """Moves to where reading stopped, or to the start of a file that was replaced."""
        file.seek(max(0, self._offset - 1))
        if inode != self._inode or (self._offset and file.read(1) != b"\n"):  # inodes are reused
            self._inode, self._offset = inode, 0
            file.seek(0)


def _last(descriptor: int) -> dict[str, Any] | None:
    lines = _tail(descriptor).rpartition(b"\n")[0].splitlines()
    return dict(json.loads(lines[-1])) if lines else None


def _tail(descriptor: int) -> bytes:
    return os.pread(descriptor, _TAIL_BYTES, max(0, os.fstat(descriptor).st_size - _TAIL_BYTES))
