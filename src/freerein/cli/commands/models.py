"""`freerein models`: the models of the learned services, and the version of each that is active."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from freerein.cli.output import AsJson, command, print_json, show_table
from freerein.errors import ServiceError, Unavailable

if TYPE_CHECKING:
    from freerein.clients import ModelClient
    from freerein.types.learning import Model

T = TypeVar("T")

_LEARNED = ("segmentation", "imitation", "reward")
_FINGERPRINT_DIGITS = 12

app = typer.Typer(
    help="Models of the segmentation, imitation and reward services. Policies of PPO runs are artifacts of their runs: "
    "see `freerein runs artifacts`.",
    no_args_is_help=True,
)


@app.command("list")
@command
def list_models(
    service: Annotated[str, typer.Option(help="One service; all learned services that answer when empty.")] = "",
    as_json: AsJson = False,
) -> None:
    """List every version of every model, newest first within a name."""
    models, silent = asyncio.run(_list([service] if service else _LEARNED))
    _show(models, as_json=as_json)
    if silent:
        typer.echo(f"Not running, so not listed: {', '.join(silent)}.", err=True)


@app.command()
@command
def activate(
    name: Annotated[str, typer.Argument(help="Model name.")],
    version: Annotated[str, typer.Argument(help="Version to activate.")],
    expected_current: Annotated[str, typer.Option(help="Refuse unless this version is active now.")] = "",
    service: Annotated[str, typer.Option(help="The service that owns the model.")] = "segmentation",
    as_json: AsJson = False,
) -> None:
    """Choose the version that answers requests that name none."""

    async def ask(client: "ModelClient") -> "Model":
        from freerein.types.learning import ActivateModelRequest

        return (await client.activate_model(ActivateModelRequest(name, version, expected_current))).model

    _show([(service, asyncio.run(_call(service, ask)))], as_json=as_json)


async def _list(services: Sequence[str]) -> "tuple[list[tuple[str, Model]], list[str]]":
    """Returns the models of all services that answer, with their service, and the services that do not answer.

    Raises:
        ServiceError: No service answers, or one refuses the call.
    """

    async def ask(client: "ModelClient") -> "tuple[Model, ...]":
        from freerein.types.learning import ListModelsRequest

        return (await client.list_models(ListModelsRequest())).models

    async def answer(service: str) -> "tuple[Model, ...] | Unavailable":
        try:
            return await _call(service, ask)
        except Unavailable as error:
            return error

    answers = dict(zip(services, await asyncio.gather(*map(answer, services)), strict=True))
    errors = {service: reply for service, reply in answers.items() if isinstance(reply, ServiceError)}
    if len(errors) == len(answers):
        raise next(iter(errors.values()))
    models = [
        (name, model) for name, reply in answers.items() if not isinstance(reply, ServiceError) for model in reply
    ]
    return models, list(errors)


async def _call(service: str, ask: "Callable[[ModelClient], Awaitable[T]]") -> T:
    from freerein.cli.connection import connect
    from freerein.clients import ModelClient

    async with connect(ModelClient, service) as client:
        return await ask(client)


def _show(models: "Sequence[tuple[str, Model]]", *, as_json: bool) -> None:
    from freerein import wire

    if as_json:
        for service, model in models:
            print_json({"service": service, **wire.to_json(model)})
        return
    rows = [
        (service, model.ref.name, model.ref.version, "active" if model.active else "", _dataset(model.card))
        for service, model in models
    ]
    show_table(("service", "model", "version", "", "dataset"), rows)


def _dataset(card: Mapping[str, Any]) -> str:
    """Returns the training data of a model in one line: task, number of trajectories, dataset fingerprint."""
    data = card.get("data", "")
    if not isinstance(data, Mapping):
        return str(data)
    fingerprint = str(data.get("fingerprint", ""))[:_FINGERPRINT_DIGITS]
    count = f"{data['trajectories']} trajectories" if "trajectories" in data else ""
    return ", ".join(filter(None, (str(card.get("task", "")), count, fingerprint)))
