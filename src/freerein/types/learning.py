"""Requests and responses of FitService and ModelService, which every learned service has."""

from dataclasses import dataclass, field
from typing import Any

from freerein.types.common import ModelRef
from freerein.types.jobs import ENDED, JobState, MetricRow


@dataclass(frozen=True)
class Fit:
    """One fit of one model.

    Attributes:
        id: 32 hexadecimal digits.
        state: Its state.
        dataset: Name of the dataset.
        model_name: Name of the resulting model.
        config: Resolved configuration, with defaults filled in.
        step: Updates done.
        steps: Updates planned.
        metrics: The latest metrics, such as `train_loss`.
        model: The resulting model; None until the fit has succeeded.
        error: Reason of the failure; empty unless it has failed.
    """

    id: str
    state: JobState
    dataset: str
    model_name: str
    config: dict[str, Any]
    step: int = 0
    steps: int = 0
    metrics: dict[str, float] = field(default_factory=dict)
    model: ModelRef | None = None
    error: str = ""

    @property
    def ended(self) -> bool:
        """Whether it has ended."""
        return self.state in ENDED


@dataclass(frozen=True)
class StartFitRequest:
    """Requests a fit.

    Attributes:
        dataset: Name of a dataset in the data directory.
        model_name: Name for the model; empty for `default`.
        config: Configuration; missing keys have their defaults.
        idempotency_key: The same key and request returns the fit already started; empty for none.
    """

    dataset: str
    model_name: str = ""
    config: dict[str, Any] = field(default_factory=dict)
    idempotency_key: str = ""


@dataclass(frozen=True)
class StartFitResponse:
    """The queued fit."""

    fit: Fit


@dataclass(frozen=True)
class GetFitRequest:
    """Requests one fit by its id."""

    id: str


@dataclass(frozen=True)
class GetFitResponse:
    """One fit."""

    fit: Fit


@dataclass(frozen=True)
class ListFitsRequest:
    """Requests one page of the fits.

    Attributes:
        page_size: Maximum number of fits, at most 1000; 0 for 100.
        page_token: `next_page_token` of the previous page; empty for the first page.
    """

    page_size: int = 0
    page_token: str = ""


@dataclass(frozen=True)
class ListFitsResponse:
    """One page of the fits.

    Attributes:
        fits: Newest first.
        next_page_token: `page_token` of the next page; empty on the last page.
    """

    fits: tuple[Fit, ...]
    next_page_token: str = ""


@dataclass(frozen=True)
class WatchFitRequest:
    """Requests the events of one fit.

    Attributes:
        id: Id of the fit.
        from_sequence: First event wanted; to resume, the last sequence number seen plus one.
    """

    id: str
    from_sequence: int = 0


@dataclass(frozen=True)
class WatchFitResponse:
    """One event of a fit: its sequence number, from 0 without gaps, and the fit after it."""

    sequence: int
    fit: Fit


@dataclass(frozen=True)
class GetFitMetricsRequest:
    """Requests the metrics of one fit.

    Attributes:
        id: Id of the fit.
        from_step: First step wanted; 0 for all.
        max_rows: Maximum number of rows, at most 10000; 0 for 1000. More rows are decimated evenly.
    """

    id: str
    from_step: int = 0
    max_rows: int = 0


@dataclass(frozen=True)
class GetFitMetricsResponse:
    """Metrics of one fit.

    Attributes:
        rows: In order of steps, evenly spaced over those recorded, always with the first and the last.
        total_rows: Number of rows recorded from `from_step` on, before decimation.
        next_step: `from_step` that returns only later rows.
    """

    rows: tuple[MetricRow, ...]
    total_rows: int
    next_step: int


@dataclass(frozen=True)
class CancelFitRequest:
    """Requests to cancel one fit by its id."""

    id: str


@dataclass(frozen=True)
class CancelFitResponse:
    """The fit, cancelled or ended before."""

    fit: Fit


@dataclass(frozen=True)
class Model:
    """One version of one model.

    Attributes:
        ref: Its name and version.
        active: Whether this version answers requests that name none.
        card: What it was trained on, how, with which figures.
    """

    ref: ModelRef
    active: bool
    card: dict[str, Any]


@dataclass(frozen=True)
class ListModelsRequest:
    """Requests the models."""


@dataclass(frozen=True)
class ListModelsResponse:
    """All versions of all models, by name, the newest version first."""

    models: tuple[Model, ...]


@dataclass(frozen=True)
class ActivateModelRequest:
    """Requests another active version.

    Attributes:
        name: The model's name; empty for `default`.
        version: The version to activate.
        expected_current: The version that the caller believes is active; empty for any.
    """

    name: str
    version: str
    expected_current: str = ""


@dataclass(frozen=True)
class ActivateModelResponse:
    """The model that is now active."""

    model: Model
