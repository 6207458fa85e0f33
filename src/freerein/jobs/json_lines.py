"""Files of JSON lines that are appended to and read at the same time. A line torn by a crash is never read."""

import fcntl
import json
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

_TAIL_BYTES = 1 << 12  # at first; doubled until it holds a whole line
_READ_BYTES = 1 << 20


def append(path: Path, make: Callable[[dict[str, Any] | None], Iterable[Mapping[str, Any]]]) -> None:
    """Appends documents durably, while no other process does; cuts off a torn last line first.

    `make` returns the documents, given the last one of the file, which is created when missing. Raises OSError when the
    disk is full or broken.
    """
    with path.open("ab+", buffering=0) as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        if torn := len(_tail(file).rpartition(b"\n")[2]):
            file.truncate(file.seek(0, os.SEEK_END) - torn)
        data = b"".join(json.dumps(document).encode() + b"\n" for document in make(_last(file)))
        while data:
            data = data[file.write(data) :]
        os.fsync(file.fileno())


def last_document(path: Path) -> dict[str, Any] | None:
    """Returns the last document of a file; None for an empty one."""
    with path.open("rb") as file:
        return _last(file)


class LineReader:
    """Reads each line once while others append; starts again when the file is replaced, and waits for a missing one."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._inode = self._offset = self._previous = 0

    def read(self) -> list[dict[str, Any]]:
        """Returns the next documents, at most 1 MiB of them; empty when there are no new ones."""
        return [json.loads(line) for line in self._read_lines()]

    def skip(self, count: int) -> int:
        """Passes over the next `count` lines unparsed, but not over the last one; returns how many it passed over."""
        skipped = 0
        while passed := self._read_lines()[:-1][: count - skipped]:
            self._offset = self._previous + sum(map(len, passed))
            skipped += len(passed)
        self.unread()
        return skipped

    def _read_lines(self) -> list[bytes]:
        if not self._path.is_file():
            return []
        with self._path.open("rb") as file:
            inode = os.fstat(file.fileno()).st_ino
            file.seek(max(0, self._offset - 1))
            if inode != self._inode or (self._offset and file.read(1) != b"\n"):  # inodes are reused
                self._inode, self._offset = inode, 0
                file.seek(0)
            self._previous = self._offset
            data = file.read(_READ_BYTES)
        lines = data[: data.rfind(b"\n") + 1].splitlines(keepends=True)
        self._offset += sum(map(len, lines))
        return lines

    def unread(self) -> None:
        """Makes the next `read` return the same documents again."""
        self._offset = self._previous


def _last(file: BinaryIO) -> dict[str, Any] | None:
    lines = _tail(file).rpartition(b"\n")[0].splitlines()
    return dict(json.loads(lines[-1])) if lines else None


def _tail(file: BinaryIO) -> bytes:
    """Returns the end of a file: its last whole line at least, and what is torn after it."""
    size, count = file.seek(0, os.SEEK_END), _TAIL_BYTES
    while True:
        file.seek(max(0, size - count))
        tail = file.read(count)
        if count >= size or tail.count(b"\n") > 1:
            return tail
        count *= 2
