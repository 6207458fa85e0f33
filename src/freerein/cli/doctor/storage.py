"""Whether the data directory can be written, has room, and is fast enough to be written durably."""

import os
import shutil
import statistics
import tempfile
import time
from pathlib import Path

from freerein.cli.doctor.finding import Finding

_NEEDED_BYTES = 1 << 30
_WANTED_BYTES = 5 << 30
_SLOW_MS = 20.0
_TRIES = 15
_CHOOSE = "Set FREEREIN_DATA_DIR to a folder that you may write"


def storage(data_dir: Path) -> list[Finding]:
    """Finds out what the data directory is like; makes it when it is missing."""
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        median_ms = _sync_ms(data_dir)
    except OSError as error:
        return [Finding("data directory", "problem", f"{data_dir}: {error.strerror}", f"{_CHOOSE}.")]
    return [Finding("data directory", "ok", str(data_dir.resolve())), _room(data_dir), _speed(median_ms)]


def _room(data_dir: Path) -> Finding:
    free = shutil.disk_usage(data_dir).free
    detail = f"{free / 1e9:.1f} GB free"
    if free >= _WANTED_BYTES:
        return Finding("disk", "ok", detail)
    state = "warning" if free >= _NEEDED_BYTES else "problem"
    return Finding("disk", state, detail, f"{_CHOOSE}, on a disk with at least 5 GB free.")  # type: ignore[arg-type]


def _speed(median_ms: float) -> Finding:
    detail = f"{median_ms:.1f} ms to write durably"
    if median_ms <= _SLOW_MS:
        return Finding("disk sync", "ok", detail)
    return Finding("disk sync", "warning", detail, f"{_CHOOSE}, on a local disk: recordings wait for each trajectory.")


def _sync_ms(folder: Path) -> float:
    """Returns how long it takes, in the median, to write 4 KiB and know that they are on disk."""
    times = []
    with tempfile.TemporaryFile(dir=folder) as file:
        for _ in range(_TRIES):
            file.write(b"\0" * 4096)
            began = time.perf_counter()
            file.flush()
            os.fsync(file.fileno())
            times.append(time.perf_counter() - began)
    return statistics.median(times) * 1e3
