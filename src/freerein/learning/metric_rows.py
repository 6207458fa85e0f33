"""The curve of a training as a file of JSON lines, without gaps or repeats however often the training was killed."""

import errno
import json
import os
from collections.abc import Mapping
from pathlib import Path

from freerein.atomic_files import write_atomic


class MetricRows:
    """A file of rows `{"step": ..., <metric>: <number>, ...}`, one per line, in order of steps.

    Args:
        path: The file; made when missing.
        last_step: Where the training goes on; rows of later steps, which will be made again, are dropped.
    """

    def __init__(self, path: Path, *, last_step: int) -> None:
        self._path = path
        lines = path.read_bytes().splitlines(keepends=True) if path.is_file() else []
        write_atomic(path, b"".join(line for line in lines if _is_kept(line, last_step)))

    def append(self, step: int, metrics: Mapping[str, float]) -> None:
        """Adds a row, whole or not at all.

        Raises:
            OSError: The disk is full or broken.
        """
        row = json.dumps({"step": step, **metrics}).encode() + b"\n"
        with self._path.open("ab", buffering=0) as file:
            end = file.seek(0, os.SEEK_END)
            if file.write(row) != len(row):
                file.truncate(end)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _is_kept(line: bytes, last_step: int) -> bool:
    if not line.endswith(b"\n"):  # torn by a crash
        return False
    step: int = json.loads(line)["step"]
    return step <= last_step
