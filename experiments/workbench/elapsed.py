"""The time that an arm takes, over all attempts, without that of what arms share."""

import json
import time
from pathlib import Path

from freerein.atomic_files import write_atomic

_MINUTE_S = 60


class Elapsed:
    """Wall-clock and CPU time of an arm, kept in a file; what passes between a `save` and a kill is lost."""

    def __init__(self, path: Path) -> None:
        self._path = path
        before = json.loads(path.read_bytes()) if path.is_file() else {"wall_s": 0.0, "cpu_s": 0.0}
        self._wall_s = before["wall_s"] - time.monotonic()
        self._cpu_s = before["cpu_s"] - time.process_time()

    @property
    def minutes(self) -> float:
        """Wall-clock time so far."""
        return (self._wall_s + time.monotonic()) / _MINUTE_S

    @property
    def cpu_minutes(self) -> float:
        """CPU time so far."""
        return (self._cpu_s + time.process_time()) / _MINUTE_S

    def save(self) -> None:
        """Writes the time so far."""
        times = {"wall_s": self.minutes * _MINUTE_S, "cpu_s": self.cpu_minutes * _MINUTE_S}
        write_atomic(self._path, json.dumps(times).encode())
