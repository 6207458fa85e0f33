"""Kind `fit`: a fit of a learned service, started once and followed to its end, whoever is killed meanwhile.

<folder>/fit.json   how many fits were given up, because they failed or were cancelled: each has a key of its own
"""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, cast

import numpy as np

from freerein.atomic_files import write_atomic
from freerein.clients import SyncClient
from freerein.errors import DeadlineExceeded, FailedPrecondition, InvalidInput, ServiceError, Unavailable
from freerein.learning.config import parse
from freerein.types.common import check_name
from freerein.types.learning import CancelFitRequest, Fit, StartFitRequest, WatchFitRequest
from freerein_orchestrator.curve import Curve
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.patience import Patience, Stopped
from freerein_orchestrator.work import Work

_LOOK_S = 0.5
_CANCEL_S = 1.0
_MOST_STEPS = 2**31


@dataclass(frozen=True)
class FitRunConfig:
    """What to fit.

    Attributes:
        service: Whose model it is.
        dataset: A dataset's name.
        model_name: The model's name.
        config: The service's own configuration; what is left out has its default there.

    Raises:
        InvalidInput: A name is none, or `steps` of the configuration is no number of steps.
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
    """Checks what a service's configuration says of steps, which a run's own steps follow from.

    Raises:
        InvalidInput: It is no whole number, or negative, or too large to be meant.
    """
    asked = config.get("steps", 0)
    is_number = isinstance(asked, int | float) and not isinstance(asked, bool)
    if not (is_number and 0 <= asked < _MOST_STEPS and asked == int(asked)):
        raise InvalidInput(
            f"`steps` must be a whole number from 0 to {_MOST_STEPS - 1}; got another value.",
            field="config.config.steps",
            hint="Leave it out for the service's default.",
        )


def resolve(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the whole configuration; the service checks the rest of its own when the fit is started."""
    return asdict(parse(FitRunConfig, values))


def steps(config: Mapping[str, Any]) -> int:
    """Returns the updates that were asked for; 0 where the service's default decides."""
    return int(config["config"].get("steps", 0))


def run(work: Work) -> bool:
    """Starts the fit, or finds the one that was started, and follows it to its end.

    When told to stop it leaves the fit to go on: the next attempt at this run follows it. A cancelled run cancels it.

    Raises:
        FailedPrecondition: The fit failed, or was cancelled at the service.
        ServiceError: The service refuses the fit.
    """
    fits = work.fits(work.config["service"])
    patience = Patience(np.random.default_rng(), stop=work.stop, say=work.say)
    following = None
    try:
        following = _Following(fits, patience.ask(lambda: _start(fits, work)), work.curve(last_step=0))
        while not following.fit.ended:
            patience.ask(following.look)
    except Stopped:
        if following is not None and work.cancelled():
            _cancel(fits, following.fit.id, work)
        return False
    _conclude(following.fit, work)
    return True


KIND = Kind(resolve, steps, run)


class _Following:
    """Follows a fit, and mirrors its metrics.

    Attributes:
        fit: As it stands.
    """

    def __init__(self, fits: SyncClient, fit: Fit, curve: Curve) -> None:
        self.fit = fit
        self._fits = fits
        self._curve = curve
        self._sequence = 0
        self._step = 0

    def look(self) -> None:
        """Watches for a moment.

        Raises:
            Unavailable: The service went away.
        """
        request = WatchFitRequest(self.fit.id, from_sequence=self._sequence)
        with suppress(DeadlineExceeded):
            for event in self._fits.watch_fit(request, timeout_s=_LOOK_S):
                self._sequence = event.sequence + 1
                self._note(event.fit)
            if not self.fit.ended:
                raise Unavailable("The events of a fit must go on to its end; they broke off.", hint="Watch it again.")

    def _note(self, fit: Fit) -> None:
        self.fit = fit
        if fit.step > self._step and fit.metrics:  # a fit whose process was killed makes some steps again
            self._step = fit.step
            self._curve.append(fit.step, fit.metrics)


def _start(fits: SyncClient, work: Work) -> Fit:
    """Returns the one fit of this work that was not given up."""
    asked = FitRunConfig(**work.config)
    while True:
        key = work.key if not _given_up(work) else f"{work.key}-{_given_up(work)}"
        request = StartFitRequest(asked.dataset, asked.model_name, asked.config, idempotency_key=key)
        fit = cast(Fit, fits.start_fit(request).fit)
        if fit.state != "cancelled":
            return fit
        _give_up(work)  # with the run, which is resumed now


def _cancel(fits: SyncClient, fit_id: str, work: Work) -> None:
    with suppress(ServiceError):  # a service that is away goes on with the fit, and so does the run when resumed
        fits.cancel_fit(CancelFitRequest(fit_id), timeout_s=_CANCEL_S)
        _give_up(work)


def _conclude(fit: Fit, work: Work) -> None:
    if fit.model is None:
        _give_up(work)
        raise FailedPrecondition(
            f"The fit must succeed; it has {fit.state}. {fit.error}" if fit.error else "The fit was cancelled.",
            hint="Once that is mended, resume the run: it begins another fit.",
        )
    work.note_model(fit.model)


def _given_up(work: Work) -> int:
    path = work.folder / "fit.json"
    return int(json.loads(path.read_bytes())["given_up"]) if path.is_file() else 0


def _give_up(work: Work) -> None:
    write_atomic(work.folder / "fit.json", json.dumps({"given_up": _given_up(work) + 1}).encode())
