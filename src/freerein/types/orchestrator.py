"""Requests and responses of the orchestrator."""

from dataclasses import dataclass, field
from typing import Any

from freerein.types.common import ModelRef
from freerein.types.jobs import Job, JobMetrics, JobMetricsRequest, JobRequest, ListJobsRequest, WatchJobRequest


@dataclass(frozen=True, kw_only=True)
class Run(Job):
    """One run; `model` is published to a service, None until a run that makes one has succeeded."""

    kind: str
    model: ModelRef | None = None


@dataclass(frozen=True)
class StartRunRequest:
    """Requests a run.

    Attributes:
        kind: Kind of the run.
        config: Configuration of the kind; missing keys have their defaults.
        idempotency_key: The same key and request returns the run already started; empty for none.
    """

    kind: str
    config: dict[str, Any] = field(default_factory=dict)
    idempotency_key: str = ""


@dataclass(frozen=True)
class GetRunResponse:
    """One run."""

    run: Run


class StartRunResponse(GetRunResponse):
    """The queued run."""


class GetRunRequest(JobRequest):
    """Requests one run by its id."""


class ListRunsRequest(ListJobsRequest):
    """Requests one page of the runs."""


@dataclass(frozen=True)
class ListRunsResponse:
    """One page of the runs, newest first; `next_page_token` is empty on the last page."""

    runs: tuple[Run, ...]
    next_page_token: str = ""


class WatchRunRequest(WatchJobRequest):
    """Requests the events of one run."""


@dataclass(frozen=True)
class WatchRunResponse:
    """One event of a run: its sequence number, from 0 without gaps, and the run after it."""

    sequence: int
    run: Run


class GetMetricsRequest(JobMetricsRequest):
    """Requests the metrics of one run."""


class GetMetricsResponse(JobMetrics):
    """Metrics of one run."""


class CancelRunRequest(JobRequest):
    """Requests to cancel one run by its id."""


class CancelRunResponse(GetRunResponse):
    """The run, cancelled or ended before."""


class ResumeRunRequest(JobRequest):
    """Requests to resume one run by its id."""


class ResumeRunResponse(GetRunResponse):
    """The run, queued again."""


class DeleteRunRequest(JobRequest):
    """Requests to delete one run by its id."""


@dataclass(frozen=True)
class DeleteRunResponse:
    """The run is deleted."""


@dataclass(frozen=True)
class Artifact:
    """A file that a run has written; `size` in bytes, `time_ns` the Unix time in nanoseconds of its last change."""

    name: str
    size: int
    time_ns: int = 0


class ListArtifactsRequest(JobRequest):
    """Requests the artifacts of one run by its id."""


@dataclass(frozen=True)
class ListArtifactsResponse:
    """The artifacts, by name."""

    artifacts: tuple[Artifact, ...]


@dataclass(frozen=True)
class GetArtifactRequest(JobRequest):
    """Requests one artifact of one run by its name."""

    name: str


@dataclass(frozen=True)
class GetArtifactResponse:
    """One part of an artifact, in order."""

    data: bytes
