"""A run's metrics: rows of JSON, which the orchestrator reads, and event files, which TensorBoard shows."""

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from freerein.jobs.event_files import EventFile
from freerein.jobs.metrics import MetricsWriter


def last_step(folder: Path, *, prefix: str = "") -> int:
    """Returns the step of the last row in a run's folder that has a metric of a prefix, 0 if there is none."""
    return int(_last_row(folder, prefix).get("step", 0))


class MetricsLogger:
    """Writes `metrics.jsonl` and `tensorboard/` in a run's folder; a row is durable when `append` returns.

    A full disk ends no training: rows that cannot be written are dropped.

    Args:
        folder: The run's folder.
        last_step: Last step to keep; later rows, which will be repeated, are dropped.
        first_step: Steps of the run before this one's.
        prefix: Prefix of the metrics' names; their event files are in a folder of that name.
        group: TensorBoard's group of metrics that are neither of rollouts nor of time.
    """

    def __init__(
        self, folder: Path, *, last_step: int, first_step: int = 0, prefix: str = "", group: str = "train"
    ) -> None:
        self._first_step = first_step
        self._prefix = prefix
        self._rows = MetricsWriter(folder / "metrics.jsonl", last_step=first_step + last_step)
        after = int(_last_row(folder).get(f"{prefix}timesteps", first_step + last_step))
        self._events = EventFile(folder / "tensorboard" / prefix, after=after, group=group)

    def append(self, step: int, metrics: Mapping[str, float]) -> None:
        """Adds a row."""
        step = self._first_step + step
        with suppress(OSError):
            self._rows.append(step, {f"{self._prefix}{name}": value for name, value in metrics.items()})
            self._rows.sync()
        self._events.append(int(metrics.get("timesteps", step)), metrics)


def _last_row(folder: Path, prefix: str = "") -> dict[str, Any]:
    path = folder / "metrics.jsonl"
    lines = path.read_bytes().rpartition(b"\n")[0].splitlines() if path.is_file() else []
    rows: Iterator[dict[str, Any]] = map(json.loads, reversed(lines))
    return next((row for row in rows if any(name.startswith(prefix) for name in row)), {})
