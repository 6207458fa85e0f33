"""Fits and models, as every learned service takes and returns them."""

from dataclasses import dataclass, field
from typing import Any, Literal

from freerein.types.common import ModelRef

FitState = Literal["queued", "running", "succeeded", "failed", "cancelled"]


@dataclass(frozen=True)
class Fit:
    """One training of one model.

    Attributes:
        id: 32 hexadecimal digits.
        state: Where it stands.
        dataset: The dataset's name.
        model_name: The name of the model that it makes.
        config: The whole configuration, defaults filled in.
        step: Updates made.
        steps: Updates planned.
        metrics: The latest metrics, such as `train_loss`.
        model: The model made, None until there is one.
        error: Why it failed, else empty.
    """

    id: str
    state: FitState
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
        """Whether nothing more will happen to it."""
        return self.state in ("succeeded", "failed", "cancelled")


@dataclass(frozen=True)
class StartFitRequest:
    """What to train, on what.

    Attributes:
        dataset: Name of a dataset in the data directory.
        model_name: Name for the model; empty for `default`.
        config: The service's configuration; what is left out has its default.
        idempotency_key: The same key and request returns the fit already started; empty for none.
    """

    dataset: str
    model_name: str = ""
    config: dict[str, Any] = field(default_factory=dict)
    idempotency_key: str = ""


@dataclass(frozen=True)
class StartFitResponse:
    """The fit, queued."""

    fit: Fit


@dataclass(frozen=True)
class GetFitRequest:
    """Asks for one fit, by its id."""

    id: str


@dataclass(frozen=True)
class GetFitResponse:
    """One fit."""

    fit: Fit


@dataclass(frozen=True)
class ListFitsRequest:
    """Asks for all fits."""


@dataclass(frozen=True)
class ListFitsResponse:
    """All fits, newest first."""

    fits: tuple[Fit, ...]


@dataclass(frozen=True)
class WatchFitRequest:
    """Asks to follow one fit.

    Attributes:
        id: The fit's id.
        from_sequence: First event wanted; to resume, one more than the last event seen.
    """

    id: str
    from_sequence: int = 0


@dataclass(frozen=True)
class WatchFitResponse:
    """One event of a fit: its number, counted from 0 without gaps, and the fit as it stood then."""

    sequence: int
    fit: Fit


@dataclass(frozen=True)
class CancelFitRequest:
    """Asks to end one fit, by its id."""

    id: str


@dataclass(frozen=True)
class CancelFitResponse:
    """The fit, cancelled or already ended."""

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
    """Asks for the models."""


@dataclass(frozen=True)
class ListModelsResponse:
    """All versions of all models, by name, the newest version first."""

    models: tuple[Model, ...]


@dataclass(frozen=True)
class ActivateModelRequest:
    """Asks for another version to answer.

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
    """The model that answers now."""

    model: Model
