"""Requests and replies that fits and runs share; messages of both services derive from them.

The module imports nothing heavy: the command line shows jobs without numpy.
"""

from dataclasses import dataclass, field
from typing import Any, Literal

JobState = Literal["queued", "running", "succeeded", "failed", "cancelled"]
ENDED: tuple[JobState, ...] = ("succeeded", "failed", "cancelled")


@dataclass(frozen=True)
class MetricRow:
    """Metrics of one step.

    Attributes:
        step: Step, counted from 1; 0 for what precedes the first step.
        metrics: Value of each metric by name; finite.
    """

    step: int
    metrics: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Job:
    """A fit or a run.

    Attributes:
        id: 32 hexadecimal digits.
        config: Resolved configuration, with defaults filled in.
        step: Steps done: updates of a fit; of a run iterations, trajectories, episodes or updates, by its kind.
        steps: Steps planned.
        metrics: The latest metrics, such as `train_loss`.
        error: Reason of the failure, or why the next attempt waits; else empty.
        time_ns: Time of its last event, Unix time in nanoseconds; 0 where none was recorded.
    """

    id: str
    state: JobState
    config: dict[str, Any]
    step: int = 0
    steps: int = 0
    metrics: dict[str, float] = field(default_factory=dict)
    error: str = ""
    time_ns: int = 0

    @property
    def ended(self) -> bool:
        """Whether it has ended; a failed or cancelled run may be resumed."""
        return self.state in ENDED


@dataclass(frozen=True)
class JobRequest:
    """Names one job by its id."""

    id: str


@dataclass(frozen=True)
class ListJobsRequest:
    """Requests one page of the jobs.

    Attributes:
        page_size: Maximum number of jobs, at most 1000; 0 for 100.
        page_token: `next_page_token` of the previous page; empty for the first page.
    """

    page_size: int = 0
    page_token: str = ""


@dataclass(frozen=True)
class WatchJobRequest(JobRequest):
    """Requests the events of one job.

    Attributes:
        from_sequence: First event wanted; to resume, the last sequence number seen plus one.
    """

    from_sequence: int = 0


@dataclass(frozen=True)
class JobMetricsRequest(JobRequest):
    """Requests the metrics of one job.

    Attributes:
        from_step: First step wanted; 0 for all.
        max_rows: Maximum number of rows, at most 10000; 0 for 1000. More rows are decimated evenly.
        keep_extremes: Of more rows, keeps those with the least and the greatest value of each metric among their
            neighbours, not evenly spaced ones: a curve keeps its shape.
    """

    from_step: int = 0
    max_rows: int = 0
    keep_extremes: bool = False


@dataclass(frozen=True)
class JobMetrics:
    """Metrics of one job.

    Attributes:
        rows: In order of steps, with the first and the last, evenly spaced over those recorded unless `keep_extremes`
            was asked for; only the last if `max_rows` is 1.
        total_rows: Number of rows recorded from `from_step` on, before decimation.
        next_step: `from_step` that returns only later rows.
    """

    rows: tuple[MetricRow, ...]
    total_rows: int
    next_step: int
