"""The guard of one engine, a program: makes the engine's folder, and clears up when the worker process has ended.

Its standard input is a pipe that only the worker holds. At its end the guard kills what runs in the folder, removes the
shared memory that nobody maps any more, and the folder. It imports the standard library alone, to start soon.
"""

import contextlib
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

_PROCESSES, _SHARED_MEMORY = Path("/proc"), Path("/dev/shm")  # noqa: S108 the engine's own place
_NAMES = "ViZDoom*"
_DEATH_S, _PAUSE_S = 5.0, 0.01


def main() -> None:
    """Writes the folder's name, waits for the end of the worker, and clears up."""
    folder = str(Path(tempfile.mkdtemp(prefix="freerein-doom-")).resolve())
    with contextlib.suppress(BrokenPipeError):  # the worker may have ended before
        os.write(sys.stdout.fileno(), f"{folder}\n".encode())
    is_closed = bool(sys.stdin.buffer.read())
    if not is_closed:
        _kill_all_in(folder)
        _remove_shared_memory()
    shutil.rmtree(folder, ignore_errors=True)


def _kill_all_in(folder: str) -> None:
    """Kills the processes whose working directory is the folder, and returns when they are gone."""
    deadline = time.monotonic() + _DEATH_S
    while (found := list(_processes_in(folder))) and time.monotonic() < deadline:
        for process in found:
            with contextlib.suppress(OSError):
                os.kill(process, signal.SIGKILL)
        time.sleep(_PAUSE_S)


def _processes_in(folder: str) -> Iterator[int]:
    for process in _PROCESSES.glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if str((process / "cwd").readlink()) == folder:
                yield int(process.name)


def _remove_shared_memory() -> None:
    """Removes what no process maps; that of an engine that runs, or starts, is mapped."""
    for segment in list(_SHARED_MEMORY.glob(_NAMES)):
        with contextlib.suppress(OSError):
            if not _is_mapped(segment):
                segment.unlink()


def _is_mapped(segment: Path) -> bool:
    for process in _PROCESSES.glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if str(segment) in (process / "maps").read_text():
                return True
    return False


if __name__ == "__main__":
    main()
