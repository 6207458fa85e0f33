"""Runs, as the orchestrator takes and returns them."""

from dataclasses import dataclass, field
from typing import Any, Literal

from freerein.types.common import ModelRef

RunKind = Literal["collect", "fit", "ppo", "distill", "evaluate", "pipeline"]
RunState = Literal["queued", "running", "succeeded", "failed", "cancelled"]
ENDED: tuple[RunState, ...] = ("succeeded", "failed", "cancelled")


@dataclass(frozen=True)
class Run:
    """One run.

    Attributes:
        id: 32 hexadecimal digits.
        kind: What it does.
        state: Where it stands.
        config: The whole configuration, defaults filled in.
        step: Steps made: iterations, trajectories, episodes or updates, as its kind has it.
        steps: Steps planned.
        metrics: The latest metrics, such as `episode_return`.
        model: The model made, of a run that makes one for a service; None until there is one.
        error: Why it failed, else empty.
    """

    id: str
    kind: RunKind
    state: RunState
    config: dict[str, Any]
    step: int = 0
    steps: int = 0
    metrics: dict[str, float] = field(default_factory=dict)
    model: ModelRef | None = None
    error: str = ""

    @property
    def ended(self) -> bool:
        """Whether nothing more will happen to it, unless it is resumed."""
        return self.state in ENDED


@dataclass(frozen=True)
class StartRunRequest:
    """What to do.

    Attributes:
        kind: What kind of run.
        config: The kind's configuration; what is left out has its default.
        idempotency_key: The same key and request returns the run already started; empty for none.
    """

    kind: RunKind
    config: dict[str, Any] = field(default_factory=dict)
    idempotency_key: str = ""


@dataclass(frozen=True)
class StartRunResponse:
    """The run, queued."""

    run: Run


@dataclass(frozen=True)
class GetRunRequest:
    """Asks for one run, by its id."""

    id: str


@dataclass(frozen=True)
class GetRunResponse:
    """One run."""

    run: Run


@dataclass(frozen=True)
class ListRunsRequest:
    """Asks for all runs."""


@dataclass(frozen=True)
class ListRunsResponse:
    """All runs, newest first."""

    runs: tuple[Run, ...]


@dataclass(frozen=True)
class WatchRunRequest:
    """Asks to follow one run.

    Attributes:
        id: The run's id.
        from_sequence: First event wanted; to resume, one more than the last event seen.
    """

    id: str
    from_sequence: int = 0


@dataclass(frozen=True)
class WatchRunResponse:
    """One event of a run: its number, counted from 0 without gaps, and the run as it stood then."""

    sequence: int
    run: Run


@dataclass(frozen=True)
class CancelRunRequest:
    """Asks to end one run, by its id."""

    id: str


@dataclass(frozen=True)
class CancelRunResponse:
    """The run, cancelled or already ended."""

    run: Run


@dataclass(frozen=True)
class ResumeRunRequest:
    """Asks to go on with one run, by its id."""

    id: str


@dataclass(frozen=True)
class ResumeRunResponse:
    """The run, queued again."""

    run: Run


@dataclass(frozen=True)
class Artifact:
    """A file that a run left behind.

    Attributes:
        name: Its name.
        size: In bytes.
    """

    name: str
    size: int


@dataclass(frozen=True)
class ListArtifactsRequest:
    """Asks what a run has left behind, by the run's id."""

    id: str


@dataclass(frozen=True)
class ListArtifactsResponse:
    """The files, by name."""

    artifacts: tuple[Artifact, ...]


@dataclass(frozen=True)
class GetArtifactRequest:
    """Asks for one of these files.

    Attributes:
        id: The run's id.
        name: The file's name.
    """

    id: str
    name: str


@dataclass(frozen=True)
class GetArtifactResponse:
    """A part of a file; the parts follow one another."""

    data: bytes
