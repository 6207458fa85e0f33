"""The progress of a fit or run: its learning curves, and the time left."""

from collections.abc import Iterable, Sequence
from typing import TypeAlias

from freerein.types.jobs import MetricRow
from freerein.types.learning import Fit
from freerein.types.orchestrator import Run

Job: TypeAlias = Fit | Run
_HISTORY_S = 1.0
_RELEVANT = ("return", "success", "accuracy", "reward", "loss")


class JobProgress:
    """The latest state of a fit or run, `job`, its curves, and the time left."""

    def __init__(self) -> None:
        self.job: Job | None = None
        self._curves: dict[str, list[tuple[int, float]]] = {}
        self._pace_from: tuple[float, int] | None = None
        self._watched_since_s: float | None = None
        self._seconds_per_step: float | None = None

    def add_rows(self, rows: Iterable[MetricRow]) -> None:
        """Adds recorded metrics; those of steps that are known already are ignored."""
        for row in rows:
            for name, value in row.metrics.items():
                curve = self._curves.setdefault(name, [])
                if not curve or curve[-1][0] < row.step:
                    curve.append((row.step, value))

    def add(self, job: Job, *, at_s: float) -> None:
        """Adds a state received at a monotonic time.

        States within a second of the first are history, which says nothing about the pace; nor does the first step,
        before which there are preparations.
        """
        if self._watched_since_s is None:
            self._watched_since_s = at_s
        if at_s - self._watched_since_s < _HISTORY_S or self._pace_from is None or not self._pace_from[1]:
            self._pace_from = at_s, job.step
        elif job.step > self._pace_from[1]:
            self._seconds_per_step = (at_s - self._pace_from[0]) / (job.step - self._pace_from[1])
        self.job = job
        self.add_rows([MetricRow(job.step, job.metrics)])

    @property
    def seconds_left(self) -> float | None:
        """Estimated time left; None where it is unknown."""
        if self.job is None or self.job.state != "running" or self._seconds_per_step is None:
            return None
        return max(0, self.job.steps - self.job.step) * self._seconds_per_step

    def points(self, name: str) -> tuple[tuple[int, float], ...]:
        """Returns the steps and values of a metric."""
        return tuple(self._curves.get(name, ()))

    def curves(self, names: Sequence[str] | None, *, most: int) -> dict[str, list[float]]:
        """Returns the values of metrics with at least two points; by default of the `most` most relevant ones."""
        drawn = [name for name, points in self._curves.items() if len(points) > 1]
        chosen = by_relevance(drawn)[:most] if names is None else [name for name in names if name in drawn]
        return {name: [value for _, value in self._curves[name]] for name in chosen}


def by_relevance(names: Iterable[str]) -> list[str]:
    """Returns names of metrics ordered by relevance: returns before losses before the rest."""

    def relevance(name: str) -> int:
        return next((place for place, word in enumerate(_RELEVANT) if word in name), len(_RELEVANT))

    return sorted(names, key=lambda name: (relevance(name), name))


def steps_text(job: Job) -> str:
    """Returns the steps done, with those planned where known, such as `3/10`."""
    return f"{job.step}/{job.steps}" if job.steps else str(job.step)


def metrics_text(job: Job) -> str:
    """Returns the latest metrics on one line."""
    return " ".join(f"{name}={job.metrics[name]:.4g}" for name in by_relevance(job.metrics))
