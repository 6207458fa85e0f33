"""Whether a child process came to a standstill, as where a file system does not answer; others wait for its place."""

import time
from contextlib import suppress
from pathlib import Path

STANDSTILL_S = 300.0
_LEAST_CPU_TICKS = 10
"""Least CPU time, in ticks of 10 ms: threads of libraries that wait use less in `STANDSTILL_S`."""


class Standstill:
    """Watches a child process, which is at a standstill after `limit_s` without progress and CPU time."""

    def __init__(self, pid: int, *, limit_s: float = STANDSTILL_S) -> None:
        self._pid = pid
        self._limit_s = limit_s
        self._ticks = 0
        self._since_s = time.monotonic()

    def is_reached(self, *, progressed: bool) -> bool:
        """Returns whether it is; called now and then, with whether it made progress or says what it waits for."""
        ticks = _cpu_ticks(self._pid) + sum(map(_cpu_ticks, _children(self._pid)))
        if progressed or abs(ticks - self._ticks) >= _LEAST_CPU_TICKS:  # fewer where a grandchild has ended unseen
            self._ticks, self._since_s = ticks, time.monotonic()
        return time.monotonic() - self._since_s >= self._limit_s


def _cpu_ticks(pid: int) -> int:
    """Returns the CPU time of a process and of its children that have ended; 0 once it has ended itself."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()  # its name may hold anything
    except OSError:
        return 0
    return sum(map(int, fields[11:15]))  # utime, stime, cutime, cstime


def _children(pid: int) -> list[int]:
    """Returns the running children of a process, such as decoders of video."""
    found = list[int]()
    with suppress(OSError):  # a thread may end meanwhile
        for thread in Path(f"/proc/{pid}/task").glob("*/children"):
            found += map(int, thread.read_text().split())
    return found
