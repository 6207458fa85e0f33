"""Requests and responses of FitService and ModelService, which every learned service has."""

from dataclasses import dataclass, field
from typing import Any

from freerein.types.common import ModelRef
from freerein.types.jobs import Job, JobMetrics, JobMetricsRequest, JobRequest, ListJobsRequest, WatchJobRequest


@dataclass(frozen=True, kw_only=True)
class Fit(Job):
    """One fit of one model.

    Attributes:
        dataset: Name of the dataset.
        model_name: Name of the resulting model.
        model: The published model; None until the fit has succeeded.
    """

    dataset: str
    model_name: str
    model: ModelRef | None = None


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
class GetFitResponse:
    """One fit."""

    fit: Fit


class StartFitResponse(GetFitResponse):
    """The queued fit."""


class GetFitRequest(JobRequest):
    """Requests one fit by its id."""


class ListFitsRequest(ListJobsRequest):
    """Requests one page of the fits."""


@dataclass(frozen=True)
class ListFitsResponse:
    """One page of the fits, newest first; `next_page_token` is empty on the last page."""

    fits: tuple[Fit, ...]
    next_page_token: str = ""


class WatchFitRequest(WatchJobRequest):
    """Requests the events of one fit."""


@dataclass(frozen=True)
class WatchFitResponse:
    """One event of a fit: its sequence number, from 0 without gaps, and the fit after it."""

    sequence: int
    fit: Fit


class GetFitMetricsRequest(JobMetricsRequest):
    """Requests the metrics of one fit."""


class GetFitMetricsResponse(JobMetrics):
    """Metrics of one fit."""


class CancelFitRequest(JobRequest):
    """Requests to cancel one fit by its id."""


class CancelFitResponse(GetFitResponse):
    """The fit, cancelled or ended before."""


class ResumeFitRequest(JobRequest):
    """Requests to resume one fit by its id."""


class ResumeFitResponse(GetFitResponse):
    """The fit, queued again."""


class DeleteFitRequest(JobRequest):
    """Requests to delete one fit by its id."""


@dataclass(frozen=True)
class DeleteFitResponse:
    """The fit is deleted."""


@dataclass(frozen=True)
class Model:
    """One version of one model.

    Attributes:
        ref: Its name and version.
        active: Whether this version answers requests that name none.
        card: What it was trained on, how, with which figures.
        time_ns: When it was published, Unix time in nanoseconds; 0 for one that comes with freerein.
    """

    ref: ModelRef
    active: bool
    card: dict[str, Any]
    time_ns: int = 0


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


@dataclass(frozen=True)
class DeleteModelRequest:
    """Requests to delete versions of a model.

    Attributes:
        name: The model's name.
        version: The version to delete; empty for all of this name, apart from those that come with freerein.
        even_active: Whether the active version may be among them.
    """

    name: str
    version: str = ""
    even_active: bool = False


@dataclass(frozen=True)
class DeleteModelResponse:
    """The versions that are deleted."""

    models: tuple[ModelRef, ...]
