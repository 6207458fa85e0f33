"""A run's metrics while it lasts: rows of JSON, which the orchestrator reads, and event files for TensorBoard."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from freerein.jobs.metrics import MetricsWriter


def last_step(folder: Path) -> int:
    """Returns the last step that a run's folder has a row of, 0 where there is none."""
    path = folder / "metrics.jsonl"
    rows = path.read_bytes().rpartition(b"\n")[0].splitlines() if path.is_file() else []
    return int(json.loads(rows[-1])["step"]) if rows else 0


class Curve:
    """Writes `metrics.jsonl` and `tensorboard/` in a run's folder. Everything is on disk after each row.

    What the disk refuses is left out, and TensorBoard's file from then on: no training ends for want of a curve.

    Args:
        folder: The run's.
        last_step: Where the run, or the present part of it, goes on; later rows, which will be made again, are dropped.
        first_step: Steps of the run before the present part's.
        prefix: Of the names of the part's metrics.
    """

    def __init__(self, folder: Path, *, last_step: int, first_step: int = 0, prefix: str = "") -> None:
        self._first_step = first_step
        self._prefix = prefix
        self._rows = MetricsWriter(folder / "metrics.jsonl", last_step=first_step + last_step)
        self._events: SummaryWriter | None = None
        with suppress(OSError):
            self._events = SummaryWriter(str(folder / "tensorboard"), purge_step=first_step + last_step + 1)

    def append(self, step: int, metrics: Mapping[str, float]) -> None:
        """Adds a row, of a step of the part."""
        step, metrics = self._first_step + step, {f"{self._prefix}{name}": value for name, value in metrics.items()}
        with suppress(OSError):
            self._rows.append(step, metrics)
        if self._events is not None:
            try:
                for name, value in metrics.items():
                    self._events.add_scalar(name, value, step)
                self._events.flush()
            except OSError:
                self._events = None

    def close(self) -> None:
        """Ends the event file."""
        if self._events is not None:
            with suppress(OSError):
                self._events.close()
