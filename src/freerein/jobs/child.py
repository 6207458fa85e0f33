"""The child process of a job: it must end with its parent, stop on SIGTERM, exit with a code that says how it ended.

And what its parent does before: it holds the lock of the job's folder, which the child holds, too.
"""

import fcntl
import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from freerein import program
from freerein.atomic_files import storage_errors
from freerein.errors import ServiceError
from freerein.jobs.allocator import keep_freed_memory

STOPPED = 143
"""Exit code of a child that was stopped by SIGTERM and can be resumed, as shells report it."""
PERMANENT_FAILURE = 2
"""Exit code of a child that cannot succeed, however often it is started; the last line of its log says why."""

OUT_OF_STORAGE = 74
"""Exit code of such a child whose disk is full, so that its log cannot say why; BSD calls it EX_IOERR."""


_POLL_S = 0.2


@contextmanager
def locked(folder: Path, should_stop: Callable[[], object]) -> Iterator[int | None]:
    """Yields the lock of a job's folder, once other parents and left-over children have let go; None when stopped."""
    with (folder / "lock").open("ab") as lock:
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if should_stop():
                    yield None
                    return
                time.sleep(_POLL_S)
            else:
                yield lock.fileno()
                return


def run_child(folder: Path, work: Callable[[Mapping[str, Any]], bool]) -> int:
    """Does the work of a job, or resumes it; ends with the process that started it.

    Args:
        folder: Folder of the job, which holds `config.json`.
        work: Given the contents of `config.json`, does the work and returns True; returns False when it was stopped.

    Returns:
        The exit code: 0, `STOPPED`, `PERMANENT_FAILURE` or `OUT_OF_STORAGE`.
    """
    program.loaded()
    keep_freed_memory()
    die_with_parent()
    try:
        with storage_errors():
            return 0 if work(json.loads((folder / "config.json").read_bytes())) else STOPPED
    except ServiceError as error:
        return _say(f"{error.detail} {error.hint}\n".encode())


def die_with_parent() -> None:
    """Ends this process as soon as its standard input closes, which its parent holds open."""
    threading.Thread(target=_wait_and_exit, name="parent", daemon=True).start()


@contextmanager
def stop_on_sigterm() -> Iterator[Callable[[], bool]]:
    """Yields a function that returns whether SIGTERM was received; on the main thread only."""
    stopped = threading.Event()
    before = signal.signal(signal.SIGTERM, lambda *_: stopped.set())
    try:
        yield stopped.is_set
    finally:
        signal.signal(signal.SIGTERM, before)


def _say(reason: bytes) -> int:
    """Writes the last line of the log; returns the exit code."""
    try:
        written = os.write(2, reason)  # not `sys.stderr`, which would try again at exit and change the code
    except OSError:
        written = 0
    return PERMANENT_FAILURE if written == len(reason) else OUT_OF_STORAGE


def _wait_and_exit() -> None:
    while os.read(0, 4096):  # not sys.stdin, whose lock the interpreter needs at its end
        pass
    os._exit(1)
