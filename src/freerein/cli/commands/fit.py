"""`freerein fit`: start, list, watch and cancel fits; their metrics."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from freerein.cli import job_display
from freerein.cli.config_options import Settings, configuration
from freerein.cli.job_progress import metrics_text, steps_text
from freerein.cli.output import AsJson, command, print_json, show_table
from freerein.errors import ServiceError, Unavailable

if TYPE_CHECKING:
    from freerein.clients import FitClient
    from freerein.types.jobs import MetricRow
    from freerein.types.learning import Fit

T = TypeVar("T")

app = typer.Typer(help="Fits of models.", no_args_is_help=True)

Service = Annotated[str, typer.Option(help="Service that fits.")]
_Services = Annotated[str, typer.Option(help="Service that fits; all when empty.")]
_FromStep = Annotated[int, typer.Option(min=0, help="First step to print.")]
_MaxRows = Annotated[int, typer.Option(min=1, max=10_000, help="Maximum number of rows; more are decimated evenly.")]
_Id = Annotated[str, typer.Argument(metavar="ID", help="Id of the fit, as listed by `freerein fit list`.")]

_SERVICES = {
    "segmentation": "Fit a skill segmentation model to demonstrations tagged with the skills that occur.",
    "imitation": "Fit a policy to a dataset: goal-conditioned by default, `--set policy=skills` for recipes of skills, "
    "`--set policy=language` for language goals.",
    "reward": "Fit a vision-language reward model to unlabelled images and noun phrases.",
}


def _add_start(service: str, explanation: str) -> None:
    """Adds the command that starts a fit of a service."""

    @app.command(service, help=explanation)
    @command
    def start(
        dataset: Annotated[str, typer.Argument(help="Name of a dataset in the data directory.")],
        model_name: Annotated[str, typer.Option(help="Name of the model; `default` when empty.")] = "",
        settings: Settings = None,
        watch: Annotated[bool, typer.Option("--watch", help="Wait for the end and draw the curves.")] = False,
        as_json: AsJson = False,
    ) -> None:
        from freerein.types.learning import StartFitRequest

        request = StartFitRequest(dataset, model_name, configuration(settings))
        fit = asyncio.run(_call(service, lambda client: client.start_fit(request))).fit
        if watch:
            _watch(service, fit.id, as_json=as_json)
        else:
            _show([(service, fit)], as_json=as_json)


for _service, _explanation in _SERVICES.items():
    _add_start(_service, _explanation)


@app.command("list")
@command
def list_fits(service: _Services = "", as_json: AsJson = False) -> None:
    """List all fits, newest first."""
    answers = asyncio.run(_ask_all(service, _all_fits))
    _show([(name, fit) for name, fits in answers.items() for fit in fits], as_json=as_json)


@app.command()
@command
def watch(fit: _Id, service: _Services = "", as_json: AsJson = False) -> None:
    """Watch a fit to its end, with its curves."""
    _watch(_service_of(fit, service), fit, as_json=as_json)


@app.command()
@command
def metrics(
    fit: _Id,
    service: _Services = "",
    *,
    from_step: _FromStep = 0,
    max_rows: _MaxRows = 1000,
    as_json: AsJson = False,
) -> None:
    """Print the metrics of a fit."""
    found = _service_of(fit, service)
    rows = asyncio.run(_call(found, lambda client: _rows(client, fit, from_step, max_rows)))
    job_display.show_metrics(rows, as_json=as_json)


@app.command()
@command
def cancel(fit: _Id, service: _Services = "", as_json: AsJson = False) -> None:
    """Cancel a fit; its last checkpoint is kept."""
    from freerein.types.learning import CancelFitRequest

    found = _service_of(fit, service)
    cancelled = asyncio.run(_call(found, lambda client: client.cancel_fit(CancelFitRequest(fit)))).fit
    _show([(found, cancelled)], as_json=as_json)


def _service_of(fit_id: str, service: str) -> str:
    """Returns the service of a fit: the one named, or the one that knows the fit.

    Raises:
        NotFound: No service knows it.
        Unavailable: No service runs.
    """
    from freerein.types.learning import GetFitRequest

    return service or next(iter(asyncio.run(_ask_all("", lambda client: client.get_fit(GetFitRequest(fit_id))))))


async def _all_fits(client: "FitClient") -> "list[Fit]":
    from freerein.types.learning import ListFitsRequest

    fits: list[Fit] = []
    token = ""
    while True:
        page = await client.list_fits(ListFitsRequest(page_token=token))
        fits += page.fits
        if not (token := page.next_page_token):
            return fits


async def _rows(client: "FitClient", fit_id: str, from_step: int, max_rows: int) -> "Sequence[MetricRow]":
    from freerein.types.learning import GetFitMetricsRequest

    return (await client.get_fit_metrics(GetFitMetricsRequest(fit_id, from_step, max_rows))).rows


async def _ask_all(service: str, ask: "Callable[[FitClient], Awaitable[T]]") -> dict[str, T]:
    """Returns the answers of the service named, or of all services that have one, by service; at least one.

    Raises:
        ServiceError: No service has an answer; the error of one that runs, if any.
    """
    asked = [service] if service else list(_SERVICES)
    replies = await asyncio.gather(*(_call(name, ask) for name in asked), return_exceptions=True)
    answers: dict[str, T] = {}
    errors: list[BaseException] = []
    for name, reply in zip(asked, replies, strict=True):
        if isinstance(reply, BaseException):
            errors.append(reply)
        else:
            answers[name] = reply
    if bugs := [error for error in errors if not isinstance(error, ServiceError)]:
        raise bugs[0]
    if not answers:
        raise next((error for error in errors if not isinstance(error, Unavailable)), errors[0])
    return answers


def _watch(service: str, fit_id: str, *, as_json: bool) -> None:
    """Shows a fit until it ends.

    Raises:
        FailedPrecondition: It did not succeed.
    """
    from freerein.cli.job_events import follow_fit

    fit = job_display.watch(
        lambda: _connect(service),
        lambda client: follow_fit(client, fit_id),
        lambda client: _rows(client, fit_id, 0, 0),
        name=f"fit {fit_id[:8]}",
        command=f"freerein fit watch {fit_id}",
        as_json=as_json,
    )
    if not as_json:
        _show([(service, fit)], as_json=False)


def _connect(service: str) -> "FitClient":
    from freerein.cli.connection import connect
    from freerein.clients import FitClient

    return connect(FitClient, service)


async def _call(service: str, ask: "Callable[[FitClient], Awaitable[T]]") -> T:
    async with _connect(service) as client:
        return await ask(client)


def _show(fits: "Sequence[tuple[str, Fit]]", *, as_json: bool) -> None:
    """Prints fits and their services."""
    from freerein import wire

    if as_json:
        for service, fit in fits:
            print_json({"service": service, **wire.to_json(fit)})
        return
    rows = [
        (
            fit.id,
            service,
            fit.state,
            fit.dataset,
            f"{fit.model.name} {fit.model.version}" if fit.model else fit.model_name,
            steps_text(fit),
            fit.error or metrics_text(fit),
        )
        for service, fit in fits
    ]
    show_table(("fit", "service", "state", "dataset", "model", "steps", "metrics"), rows)
