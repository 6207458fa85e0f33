"""Requests and responses of the orchestrator."""

from dataclasses import dataclass, field
from typing import Any, Literal

from freerein.types.common import ModelRef
from freerein.types.jobs import ENDED, JobState, MetricRow

RunKind = Literal["collect", "fit", "ppo", "distill", "evaluate", "pipeline"]


@dataclass(frozen=True)
class Run:
    """One run.

    Attributes:
        id: 32 hexadecimal digits.
        kind: Its kind.
        state: Its state.
        config: Resolved configuration, with defaults filled in.
        step: Steps done: iterations, trajectories, episodes or updates, depending on the kind.
        steps: Steps planned.
        metrics: The latest metrics, such as `episode_return`.
        model: Model published to a service; None until a run that makes one has succeeded.
        error: Reason of the failure; empty unless it has failed.
    """

    id: str
    kind: RunKind
    state: JobState
    config: dict[str, Any]
    step: int = 0
    steps: int = 0
    metrics: dict[str, float] = field(default_factory=dict)
    model: ModelRef | None = None
    error: str = ""

    @property
    def ended(self) -> bool:
        """Whether it has ended; a failed or cancelled run may be resumed."""
        return self.state in ENDED


@dataclass(frozen=True)
class StartRunRequest:
    """Requests a run.

    Attributes:
        kind: Kind of the run.
        config: Configuration of the kind; missing keys have their defaults.
        idempotency_key: The same key and request returns the run already started; empty for none.
    """

    kind: RunKind
    config: dict[str, Any] = field(default_factory=dict)
    idempotency_key: str = ""


@dataclass(frozen=True)
class StartRunResponse:
    """The queued run."""

    run: Run


@dataclass(frozen=True)
class GetRunRequest:
    """Requests one run by its id."""

    id: str


@dataclass(frozen=True)
class GetRunResponse:
    """One run."""

    run: Run


@dataclass(frozen=True)
class ListRunsRequest:
    """Requests one page of the runs.

    Attributes:
        page_size: Maximum number of runs, at most 1000; 0 for 100.
        page_token: `next_page_token` of the previous page; empty for the first page.
    """

    page_size: int = 0
    page_token: str = ""


@dataclass(frozen=True)
class ListRunsResponse:
    """One page of the runs.

    Attributes:
        runs: Newest first.
        next_page_token: `page_token` of the next page; empty on the last page.
    """

    runs: tuple[Run, ...]
    next_page_token: str = ""


@dataclass(frozen=True)
class WatchRunRequest:
    """Requests the events of one run.

    Attributes:
        id: Id of the run.
        from_sequence: First event wanted; to resume, the last sequence number seen plus one.
    """

    id: str
    from_sequence: int = 0


@dataclass(frozen=True)
class WatchRunResponse:
    """One event of a run: its sequence number, from 0 without gaps, and the run after it."""

    sequence: int
    run: Run


@dataclass(frozen=True)
class GetMetricsRequest:
    """Requests the metrics of one run.

    Attributes:
        id: Id of the run.
        from_step: First step wanted; 0 for all.
        max_rows: Maximum number of rows, at most 10000; 0 for 1000. More rows are decimated evenly.
    """

    id: str
    from_step: int = 0
    max_rows: int = 0


@dataclass(frozen=True)
class GetMetricsResponse:
    """Metrics of one run.

    Attributes:
        rows: In order of steps, evenly spaced over those recorded, always with the first and the last.
        total_rows: Number of rows recorded from `from_step` on, before decimation.
        next_step: `from_step` that returns only later rows.
    """

    rows: tuple[MetricRow, ...]
    total_rows: int
    next_step: int


@dataclass(frozen=True)
class CancelRunRequest:
    """Requests to cancel one run by its id."""

    id: str


@dataclass(frozen=True)
class CancelRunResponse:
    """The run, cancelled or ended before."""

    run: Run


@dataclass(frozen=True)
class ResumeRunRequest:
    """Requests to resume one run by its id."""

    id: str


@dataclass(frozen=True)
class ResumeRunResponse:
    """The run, queued again."""

    run: Run


@dataclass(frozen=True)
class Artifact:
    """A file that a run has written.

    Attributes:
        name: File name.
        size: Size in bytes.
    """

    name: str
    size: int


@dataclass(frozen=True)
class ListArtifactsRequest:
    """Requests the artifacts of one run by its id."""

    id: str


@dataclass(frozen=True)
class ListArtifactsResponse:
    """The artifacts, by name."""

    artifacts: tuple[Artifact, ...]


@dataclass(frozen=True)
class GetArtifactRequest:
    """Requests one artifact.

    Attributes:
        id: Id of the run.
        name: Name of the artifact.
    """

    id: str
    name: str


@dataclass(frozen=True)
class GetArtifactResponse:
    """One part of an artifact, in order."""

    data: bytes
