"""Which nonsense a service is to answer, and how often: a file such as `nan 3`. A test tells, the service counts."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from freerein.atomic_files import write_atomic


def tell(told: Path, lies: str) -> None:
    """Tells which lie is next, and how often; none of those told before is counted any more."""
    with _alone(told):
        write_atomic(told, lies.encode())


def next_lie(told: Path) -> str:
    """Returns which lie is next, and counts it."""
    with _alone(told):
        kind, _, left = told.read_text().partition(" ") if told.exists() else ("", "", "0")
        if not int(left or 0):
            return ""
        write_atomic(told, f"{kind} {int(left) - 1}".encode())
    return kind


@contextmanager
def _alone(told: Path) -> Iterator[None]:
    """Holds a lock that one process has at a time."""
    with told.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
