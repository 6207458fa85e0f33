"""A run's metrics: rows of JSON, which the orchestrator reads, and event files for TensorBoard."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from freerein.jobs.metrics import MetricsWriter


def last_step(folder: Path) -> int:
    """Returns the step of the last row in a run's folder, 0 if there is none."""
    path = folder / "metrics.jsonl"
    rows = path.read_bytes().rpartition(b"\n")[0].splitlines() if path.is_file() else []
    return int(json.loads(rows[-1])["step"]) if rows else 0


class MetricsLogger:
    """Writes `metrics.jsonl` and `tensorboard/` in a run's folder; a row is durable when `append` returns.

    A full disk ends no training: rows that cannot be written are dropped, and TensorBoard's file from then on.

    Args:
        folder: The run's folder.
        last_step: Last step to keep; later rows, which will be repeated, are dropped.
        first_step: Steps of the run before this one's.
        prefix: Prefix of the metrics' names.
    """

    def __init__(self, folder: Path, *, last_step: int, first_step: int = 0, prefix: str = "") -> None:
        self._first_step = first_step
        self._prefix = prefix
        self._rows = MetricsWriter(folder / "metrics.jsonl", last_step=first_step + last_step)
        self._events: SummaryWriter | None = None
        with suppress(OSError):
            self._events = SummaryWriter(str(folder / "tensorboard"), purge_step=first_step + last_step + 1)

    def append(self, step: int, metrics: Mapping[str, float]) -> None:
        """Adds a row."""
        step, metrics = self._first_step + step, {f"{self._prefix}{name}": value for name, value in metrics.items()}
        with suppress(OSError):
            self._rows.append(step, metrics)
            self._rows.sync()
        if self._events is not None:
            try:
                for name, value in metrics.items():
                    self._events.add_scalar(name, value, step)
                self._events.flush()
            except OSError:
                self._events = None

    def close(self) -> None:
        """Closes the event file."""
        if self._events is not None:
            with suppress(OSError):
                self._events.close()
