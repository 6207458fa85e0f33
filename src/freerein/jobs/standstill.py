"""Whether a child process came to a standstill, as where a file system does not answer; others wait for its place."""

import time
from pathlib import Path

STANDSTILL_S = 300.0
_LEAST_CPU_TICKS = 10
"""Of 10 ms each: threads of libraries that wait use less in `STANDSTILL_S`."""


class Standstill:
    """Watches a child process.

    Args:
        pid: Its process id.
        limit_s: Seconds without progress and CPU time after which it is at a standstill.
    """

    def __init__(self, pid: int, *, limit_s: float = STANDSTILL_S) -> None:
        self._stat = Path(f"/proc/{pid}/stat")
        self._limit_s = limit_s
        self._ticks = 0
        self._since_s = time.monotonic()

    def is_reached(self, *, progressed: bool) -> bool:
        """Returns whether the child is at a standstill; to be called every now and then.

        Args:
            progressed: Whether it made progress since the last call, or says what it waits for.
        """
        ticks = self._cpu_ticks()
        if progressed or ticks >= self._ticks + _LEAST_CPU_TICKS:
            self._ticks, self._since_s = ticks, time.monotonic()
        return time.monotonic() - self._since_s >= self._limit_s

    def _cpu_ticks(self) -> int:
        """Returns the CPU time of the child and of its own children that have ended; 0 once it has ended."""
        try:
            fields = self._stat.read_text().rpartition(")")[2].split()  # its name may hold anything
        except OSError:
            return 0
        return sum(map(int, fields[11:15]))  # utime, stime, cutime, cstime
