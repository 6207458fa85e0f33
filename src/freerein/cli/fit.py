"""`freerein fit`: trainings, started, listed, watched, cancelled."""

import asyncio
import json
from collections.abc import Awaitable, Callable
from contextlib import aclosing
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from freerein.cli.output import AsJson, print_json, progress_bar, show_table, verb
from freerein.errors import FailedPrecondition, InvalidInput

if TYPE_CHECKING:
    from freerein.clients import FitClient
    from freerein.types.learning import Fit

T = TypeVar("T")

app = typer.Typer(help="Trainings: started, listed, watched, cancelled.", no_args_is_help=True)

Service = Annotated[str, typer.Option(help="The service that trains.")]
_Id = Annotated[str, typer.Argument(metavar="ID", help="What `freerein fit list` lists.")]


@app.command()
@verb
def segmentation(
    dataset: Annotated[str, typer.Argument(help="Name of a dataset in the data directory.")],
    model_name: Annotated[str, typer.Option(help="Name for the model; `default` when empty.")] = "",
    settings: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Not as by default.")] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Wait for the end.")] = False,
    as_json: AsJson = False,
) -> None:
    """Learn which skill is executed when, from demonstrations tagged with the skills that occur."""
    config = dict(_setting(text) for text in settings or ())

    async def start(client: "FitClient") -> "Fit":
        from freerein.types.learning import StartFitRequest

        return (await client.start_fit(StartFitRequest(dataset, model_name, config))).fit

    fit = asyncio.run(_call("segmentation", start))
    if watch:
        _watch("segmentation", fit.id, as_json=as_json)
    else:
        _show([fit], as_json=as_json)


@app.command("list")
@verb
def list_fits(service: Service = "segmentation", as_json: AsJson = False) -> None:
    """List all fits, the newest first."""

    async def ask(client: "FitClient") -> "tuple[Fit, ...]":
        from freerein.types.learning import ListFitsRequest

        return (await client.list_fits(ListFitsRequest())).fits

    _show(asyncio.run(_call(service, ask)), as_json=as_json)


@app.command()
@verb
def watch(fit: _Id, service: Service = "segmentation", as_json: AsJson = False) -> None:
    """Follow a fit to its end."""
    _watch(service, fit, as_json=as_json)


@app.command()
@verb
def cancel(fit: _Id, service: Service = "segmentation", as_json: AsJson = False) -> None:
    """End a fit; its last checkpoint stays."""

    async def ask(client: "FitClient") -> "Fit":
        from freerein.types.learning import CancelFitRequest

        return (await client.cancel_fit(CancelFitRequest(fit))).fit

    _show([asyncio.run(_call(service, ask))], as_json=as_json)


def _watch(service: str, fit_id: str, *, as_json: bool) -> None:
    """Shows a fit's progress until it ends.

    Raises:
        FailedPrecondition: It ended without a model.
    """
    with progress_bar(f"fit {fit_id[:8]}", total=1, is_shown=not as_json) as advance:

        async def follow_to_the_end(client: "FitClient") -> "Fit":
            from freerein import wire
            from freerein.cli.fitting import follow

            async with aclosing(follow(client, fit_id)) as changes:
                async for fit in changes:
                    last = fit
                    advance(fit.step, f"{fit.state} {_figures(fit)}", total=fit.steps or 1)
                    if as_json:
                        print_json(wire.to_json(fit))
            return last

        fit = asyncio.run(_call(service, follow_to_the_end))
    if fit.state != "succeeded":
        sentence = f"The fit must succeed; its state is {fit.state}. {fit.error}".rstrip()
        raise FailedPrecondition(sentence, hint=_LOG_HINT)
    if not as_json:
        _show([fit], as_json=False)


_LOG_HINT = "The data directory's fits/<service>/<id>/work/log.txt says more."


async def _call(service: str, ask: "Callable[[FitClient], Awaitable[T]]") -> T:
    from freerein.cli.connection import open_channel
    from freerein.cli.settings import CliSettings
    from freerein.clients import FitClient

    async with FitClient(open_channel(service, CliSettings())) as client:
        return await ask(client)


def _setting(text: str) -> tuple[str, object]:
    """Returns a setting's key and value: a JSON value, else a string."""
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise InvalidInput(
            "A setting must be KEY=VALUE; got one without a key or a value.",
            field="set",
            hint="Write --set updates=200 or --set objective=mil.",
        )
    try:
        return key, json.loads(value)
    except json.JSONDecodeError:
        return key, value


def _show(fits: "list[Fit] | tuple[Fit, ...]", *, as_json: bool) -> None:
    from freerein import wire

    if as_json:
        for fit in fits:
            print_json(wire.to_json(fit))
        return
    rows = [
        (
            fit.id,
            fit.state,
            fit.dataset,
            f"{fit.model.name} {fit.model.version}" if fit.model else fit.model_name,
            f"{fit.step}/{fit.steps}",
            fit.error or _figures(fit),
        )
        for fit in fits
    ]
    show_table(("fit", "state", "dataset", "model", "updates", "figures"), rows)


def _figures(fit: "Fit") -> str:
    return " ".join(f"{name}={value:.4g}" for name, value in fit.metrics.items())
