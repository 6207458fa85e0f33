"""Checks of the data directory: writable, enough space, fast sync."""

import os
import shutil
import statistics
import tempfile
import time
from pathlib import Path

from freerein.cli.doctor.check_result import CheckResult

_NEEDED_BYTES = 1 << 30
_WANTED_BYTES = 5 << 30
_SLOW_MS = 20.0
_TRIES = 15
_CHOOSE = "Set FREEREIN_DATA_DIR to a folder that you may write"


def check_storage(data_dir: Path) -> list[CheckResult]:
    """Checks the data directory; creates it where it is missing."""
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        median_ms = _sync_ms(data_dir)
    except OSError as error:
        return [CheckResult("data directory", "problem", f"{data_dir}: {error.strerror}", f"{_CHOOSE}.")]
    return [
        CheckResult("data directory", "ok", str(data_dir.resolve())),
        _check_space(data_dir),
        _check_sync(median_ms),
    ]


def _check_space(data_dir: Path) -> CheckResult:
    free = shutil.disk_usage(data_dir).free
    detail = f"{free / 1e9:.1f} GB free"
    if free >= _WANTED_BYTES:
        return CheckResult("disk", "ok", detail)
    state = "warning" if free >= _NEEDED_BYTES else "problem"
    return CheckResult("disk", state, detail, f"{_CHOOSE}, on a disk with at least 5 GB free.")  # type: ignore[arg-type]


def _check_sync(median_ms: float) -> CheckResult:
    detail = f"{median_ms:.1f} ms per fsync"
    if median_ms <= _SLOW_MS:
        return CheckResult("disk sync", "ok", detail)
    return CheckResult("disk sync", "warning", detail, f"{_CHOOSE}, on a local disk: recording syncs each trajectory.")


def _sync_ms(folder: Path) -> float:
    """Returns the median duration in milliseconds of writing 4 KiB with fsync."""
    times = []
    with tempfile.TemporaryFile(dir=folder) as file:
        for _ in range(_TRIES):
            file.write(b"\0" * 4096)
            began = time.perf_counter()
            file.flush()
            os.fsync(file.fileno())
            times.append(time.perf_counter() - began)
    return statistics.median(times) * 1e3
