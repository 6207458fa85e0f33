"""Kind `fit`: starts a fit of a learned service once, and follows it to its end.

<folder>/fit.json   id of the fit; gone once it has failed or was cancelled: the run, when resumed, resumes it
"""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

from freerein.atomic_files import fsync_folder, write_atomic
from freerein.clients import SyncClient
from freerein.config import parse
from freerein.errors import DeadlineExceeded, FailedPrecondition, InvalidInput, ServiceError, Unavailable
from freerein.types.common import check_name
from freerein.types.learning import (
    CancelFitRequest,
    Fit,
    GetFitRequest,
    ResumeFitRequest,
    StartFitRequest,
    WatchFitRequest,
)
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.kind import Kind, RemoteWork
from freerein_orchestrator.kinds.metrics_logger import MetricsLogger
from freerein_orchestrator.rl.errors import Stopped

_WATCH_S = 0.5
_REST_S = 30.0
_CANCEL_S = 1.0
_MAX_STEPS = 2**31


@dataclass(frozen=True)
class FitRunConfig:
    """Configuration of a run of kind `fit`.

    Attributes:
        service: The learned service.
        dataset: The dataset's name.
        model_name: The model's name.
        config: The service's own configuration.

    Raises:
        InvalidInput: A name, or `steps` of the service's configuration, is invalid.
    """

    service: Literal["segmentation", "imitation", "reward"]
    dataset: str
    model_name: str = "default"
    config: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_name(self.dataset, field="config.dataset")
        check_name(self.model_name, field="config.model_name")
        check_steps(self.config)


def check_steps(config: Mapping[str, Any]) -> None:
    """Checks `steps` of a service's configuration, which the run's own steps derive from.

    Raises:
        InvalidInput: It is not a whole number in range.
    """
    asked = config.get("steps", 0)
    is_number = isinstance(asked, int | float) and not isinstance(asked, bool)
    if not (is_number and 0 <= asked < _MAX_STEPS and asked == int(asked)):
        raise InvalidInput(
            f"`steps` must be a whole number from 0 to {_MAX_STEPS - 1}; got another value.",
            field="config.config.steps",
            hint="Leave it out for the service's default.",
        )


def run(context: RunContext, config: FitRunConfig) -> None:
    """Starts the fit, or finds the one that was started, and follows it to its end.

    Told to stop, it leaves the fit running: the next attempt at this run follows it. A cancelled run cancels it.

    Raises:
        Stopped: The run is to stop.
        FailedPrecondition: The fit failed, or was cancelled at the service.
        ServiceError: The service refuses the fit.
    """
    fits, retry = context.fits(config.service), context.retry()
    watch = None
    try:
        watch = _FitWatch(fits, retry.call(lambda: _start(fits, context, config)), context.metrics_logger(0))
        while not watch.ended:
            retry.call(watch.poll)
    except Stopped:
        if watch is not None and context.cancelled():
            _cancel(fits, watch.fit.id, context)
        raise
    if watch.fit.model is None:
        _forget_id(context)
        raise FailedPrecondition(
            f"The fit must succeed; it has {watch.fit.state}. {watch.fit.error}"
            if watch.fit.error
            else "The fit was cancelled.",
            hint="Resume the run once the cause is mended: the fit continues from its last checkpoint.",
        )
    context.record_model(watch.fit.model)


def begin(context: RunContext, config: FitRunConfig) -> None:
    """Starts the fit, unless it was started already; `run` will follow it."""
    if not _saved_id(context):
        fits = context.fits(config.service)
        context.retry().call(lambda: _start(fits, context, config))


def cancel(context: RunContext, config: FitRunConfig) -> None:
    """Cancels the fit that was started, if any; an unavailable service continues it."""
    if fit_id := _saved_id(context):
        _cancel(context.fits(config.service), fit_id, context)


KIND = Kind(
    {"": FitRunConfig},
    partial(parse, FitRunConfig),
    steps=lambda config: int(config.config.get("steps", 0)),
    run=run,
    remote=RemoteWork(begin, cancel),
    meaning="Fits a model of a learned service to a dataset, as New fit does, with artifacts of its own.",
)


class _FitWatch:
    """Follows a fit, and copies its metrics.

    Attributes:
        fit: Its latest state.
        ended: Whether it has ended: there are no events after the latest. One that was resumed has ended before, too.
    """

    def __init__(self, fits: SyncClient, fit: Fit, metrics: MetricsLogger) -> None:
        self.fit = fit
        self.ended = False
        self._fits = fits
        self._metrics = metrics
        self._sequence = 0
        self._step = 0

    def poll(self) -> None:
        """Watches for a moment; once the fit has ended, for as long as its last events take.

        Raises:
            Unavailable: The service went away.
        """
        fit = self._fits.get_fit(GetFitRequest(self.fit.id)).fit
        request = WatchFitRequest(fit.id, from_sequence=self._sequence)
        with suppress(DeadlineExceeded):
            for event in self._fits.watch_fit(request, timeout_s=_REST_S if fit.ended else _WATCH_S):
                self._sequence = event.sequence + 1
                self.fit = event.fit
                if self.fit.step > self._step and self.fit.metrics:  # a killed fit repeats some steps
                    self._step = self.fit.step
                    self._metrics.append(self.fit.step, self.fit.metrics)
            if not self.fit.ended:
                raise Unavailable("A fit's events must continue to its end; they broke off.", hint="Watch it again.")
            self.ended = True


def _start(fits: SyncClient, context: RunContext, config: FitRunConfig) -> Fit:
    """Returns the fit of this run; resumes one that ended with an earlier attempt, for the run is resumed now."""
    request = StartFitRequest(config.dataset, config.model_name, config.config, idempotency_key=context.key)
    fit = fits.start_fit(request).fit
    if fit.state == "cancelled" or (fit.state == "failed" and not _saved_id(context)):
        fit = fits.resume_fit(ResumeFitRequest(fit.id)).fit
    write_atomic(context.folder / "fit.json", json.dumps({"id": fit.id}).encode())
    return fit


def _cancel(fits: SyncClient, fit_id: str, context: RunContext) -> None:
    with suppress(ServiceError):  # an unavailable service continues the fit, and so does the run when resumed
        fit = fits.cancel_fit(CancelFitRequest(fit_id), timeout_s=_CANCEL_S).fit
        if fit.state != "succeeded":
            _forget_id(context)


def _saved_id(context: RunContext) -> str:
    path = context.folder / "fit.json"
    return str(json.loads(path.read_bytes())["id"]) if path.is_file() else ""


def _forget_id(context: RunContext) -> None:
    path = context.folder / "fit.json"
    with suppress(OSError):  # why the run ends is what matters
        path.unlink(missing_ok=True)
        fsync_folder(path.parent)
