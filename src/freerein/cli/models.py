"""`freerein models`: which there are, and which one answers."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from freerein.cli.fit import Service
from freerein.cli.output import AsJson, command, print_json, show_table

if TYPE_CHECKING:
    from freerein.clients import ModelClient
    from freerein.types.learning import Model

T = TypeVar("T")

app = typer.Typer(help="Models: which there are, and which one answers.", no_args_is_help=True)


@app.command("list")
@command
def list_models(service: Service = "segmentation", as_json: AsJson = False) -> None:
    """List every version of every model, the newest first."""

    async def ask(client: "ModelClient") -> "tuple[Model, ...]":
        from freerein.types.learning import ListModelsRequest

        return (await client.list_models(ListModelsRequest())).models

    _show(asyncio.run(_call(service, ask)), as_json=as_json)


@app.command()
@command
def activate(
    name: Annotated[str, typer.Argument(help="The model's name.")],
    version: Annotated[str, typer.Argument(help="The version that is to answer.")],
    expected_current: Annotated[str, typer.Option(help="Refuse when another version answers now.")] = "",
    service: Service = "segmentation",
    as_json: AsJson = False,
) -> None:
    """Choose the version that answers requests that name none."""

    async def ask(client: "ModelClient") -> "Model":
        from freerein.types.learning import ActivateModelRequest

        return (await client.activate_model(ActivateModelRequest(name, version, expected_current))).model

    _show([asyncio.run(_call(service, ask))], as_json=as_json)


async def _call(service: str, ask: "Callable[[ModelClient], Awaitable[T]]") -> T:
    from freerein.cli.connection import connect
    from freerein.clients import ModelClient

    async with connect(ModelClient, service) as client:
        return await ask(client)


def _show(models: "list[Model] | tuple[Model, ...]", *, as_json: bool) -> None:
    from freerein import wire

    if as_json:
        for model in models:
            print_json(wire.to_json(model))
        return
    rows = [
        (model.ref.name, model.ref.version, "active" if model.active else "", str(model.card.get("dataset", "")))
        for model in models
    ]
    show_table(("model", "version", "", "dataset"), rows)
