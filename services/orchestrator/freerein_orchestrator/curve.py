"""A run's metrics while it lasts: rows of JSON, which the orchestrator reads, and event files for TensorBoard."""

from collections.abc import Mapping
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from freerein.learning.metric_rows import MetricRows


class Curve:
    """Writes `metrics.jsonl` and `tensorboard/` in a run's folder. Everything is on disk after each row.

    Args:
        folder: The run's.
        last_step: Where the run goes on; later rows, which will be made again, are dropped.
    """

    def __init__(self, folder: Path, *, last_step: int) -> None:
        self._rows = MetricRows(folder / "metrics.jsonl", last_step=last_step)
        self._events = SummaryWriter(str(folder / "tensorboard"), purge_step=last_step + 1)

    def append(self, step: int, metrics: Mapping[str, float]) -> None:
        """Adds a row."""
        for name, value in metrics.items():
            self._events.add_scalar(name, value, step)
        self._events.flush()
        self._rows.append(step, metrics)

    def close(self) -> None:
        """Ends the event file."""
        self._events.close()
