"""`freerein fit`: trainings, started, listed, watched, cancelled."""

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from contextlib import aclosing
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from freerein.cli import watching
from freerein.cli.configuring import Settings, configuration
from freerein.cli.output import AsJson, command, print_json, show_table
from freerein.cli.underway import steps_of
from freerein.errors import ServiceError, Unavailable

if TYPE_CHECKING:
    from freerein.clients import FitClient
    from freerein.types.learning import Fit

T = TypeVar("T")

app = typer.Typer(help="Trainings: started, listed, watched, cancelled.", no_args_is_help=True)

Service = Annotated[str, typer.Option(help="The service that trains.")]
_Services = Annotated[str, typer.Option(help="The service that trains; all that do when empty.")]
_Id = Annotated[str, typer.Argument(metavar="ID", help="What `freerein fit list` lists.")]

_LEARN = {
    "segmentation": "Learn which skill is executed when, from demonstrations tagged with the skills that occur.",
    "imitation": "Learn a policy from a dataset; `--set policy=skills` for one that follows recipes of skills, "
    "`--set policy=language` for one that is told in words what to do.",
    "reward": "Learn how well images match words, from unlabelled images and noun phrases.",
}


def _add_start(service: str, explanation: str) -> None:
    """Adds the verb that starts a fit of a service: the same call to each of them."""

    @app.command(service, help=explanation)
    @command
    def start(
        dataset: Annotated[str, typer.Argument(help="Name of a dataset in the data directory.")],
        model_name: Annotated[str, typer.Option(help="Name for the model; `default` when empty.")] = "",
        settings: Settings = None,
        watch: Annotated[bool, typer.Option("--watch", help="Wait for the end.")] = False,
        as_json: AsJson = False,
    ) -> None:
        config = configuration(settings)

        async def ask(client: "FitClient") -> "Fit":
            from freerein.types.learning import StartFitRequest

            return (await client.start_fit(StartFitRequest(dataset, model_name, config))).fit

        fit = asyncio.run(_call(service, ask))
        if watch:
            _watch(service, fit.id, as_json=as_json)
        else:
            _show([(service, fit)], as_json=as_json)


for _service, _explanation in _LEARN.items():
    _add_start(_service, _explanation)


@app.command("list")
@command
def list_fits(service: _Services = "", as_json: AsJson = False) -> None:
    """List all fits, the newest first."""

    async def ask(client: "FitClient") -> "tuple[Fit, ...]":
        from freerein.types.learning import ListFitsRequest

        return (await client.list_fits(ListFitsRequest())).fits

    answers = asyncio.run(_ask_all(service, ask))
    _show([(name, fit) for name, fits in answers.items() for fit in fits], as_json=as_json)


@app.command()
@command
def watch(fit: _Id, service: _Services = "", as_json: AsJson = False) -> None:
    """Follow a fit to its end."""
    _watch(_service_of(fit, service), fit, as_json=as_json)


@app.command()
@command
def cancel(fit: _Id, service: _Services = "", as_json: AsJson = False) -> None:
    """End a fit; its last checkpoint stays."""

    async def ask(client: "FitClient") -> "Fit":
        from freerein.types.learning import CancelFitRequest

        return (await client.cancel_fit(CancelFitRequest(fit))).fit

    found = _service_of(fit, service)
    _show([(found, asyncio.run(_call(found, ask)))], as_json=as_json)


def _service_of(fit_id: str, service: str) -> str:
    """Returns the service that a fit belongs to, where none was named the one that knows it.

    Raises:
        NotFound: None of them does.
        Unavailable: None of them runs.
    """

    async def ask(client: "FitClient") -> None:
        from freerein.types.learning import GetFitRequest

        await client.get_fit(GetFitRequest(fit_id))

    return service or next(iter(asyncio.run(_ask_all("", ask))))


async def _ask_all(service: str, ask: "Callable[[FitClient], Awaitable[T]]") -> dict[str, T]:
    """Returns the answers of the service named, or where none is named, of all that have one: at least one has.

    Raises:
        ServiceError: None has an answer: what the one that runs said.
    """
    asked = [service] if service else list(_LEARN)
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
    """Shows a fit's progress until it ends.

    Raises:
        FailedPrecondition: It ended without a model.
    """
    name = f"fit {fit_id[:8]}"
    way_back = f"freerein fit watch {fit_id}"
    fit = watching.watch(_changes(service, fit_id), name=name, way_back=way_back, as_json=as_json)
    if not as_json:
        _show([(service, fit)], as_json=False)


async def _changes(service: str, fit_id: str) -> "AsyncGenerator[Fit, None]":
    from freerein.cli.connection import connect
    from freerein.cli.following import follow_fit
    from freerein.clients import FitClient

    async with connect(FitClient, service) as client, aclosing(follow_fit(client, fit_id)) as fits:
        async for fit in fits:
            yield fit


async def _call(service: str, ask: "Callable[[FitClient], Awaitable[T]]") -> T:
    from freerein.cli.connection import connect
    from freerein.clients import FitClient

    async with connect(FitClient, service) as client:
        return await ask(client)


def _show(fits: "Sequence[tuple[str, Fit]]", *, as_json: bool) -> None:
    """Prints fits and the services that they belong to."""
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
            steps_of(fit),
            fit.error or watching.figures(fit),
        )
        for service, fit in fits
    ]
    show_table(("fit", "service", "state", "dataset", "model", "updates", "figures"), rows)
