"""`freerein models`: the models of the learned services, and the version of each that is active."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from freerein import wire
from freerein.cli.commands.jobs import find
from freerein.cli.connection import call, call_each, check_all_answer, check_only_unavailable
from freerein.cli.output import AsJson, command, print_json
from freerein.cli.settings import CliSettings
from freerein.cli.tables import show_all
from freerein.cli.times import ago
from freerein.clients import ImitationClient, ModelClient
from freerein.errors import InvalidInput, NotFound, quoted
from freerein.jobs import wall_clock
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.stack import choose
from freerein.types.common import ModelRef, check_name
from freerein.types.imitation import PublishPolicyRequest
from freerein.types.learning import ActivateModelRequest, DeleteModelRequest, ListModelsRequest, Model

_LEARNED = dict.fromkeys(("segmentation", "imitation", "reward"), ModelClient)
_FINGERPRINT_DIGITS = 12

_Owner = Annotated[str, typer.Option(help="The service that owns the model; the one that has it when empty.")]

app = typer.Typer(
    help="Models of the segmentation, imitation and reward services.",
    no_args_is_help=True,
    add_completion=False,
)


@app.command("list")
@command
def list_models(
    service: Annotated[str, typer.Option(help="One service; all learned services that answer when empty.")] = "",
    as_json: AsJson = False,
) -> None:
    """List every version of every model, newest first within a name."""
    asked = {service: ModelClient} if service else _LEARNED
    answers, errors = call_each(asked, lambda client: client.list_models(ListModelsRequest()))
    check_only_unavailable(errors)
    _show([(name, model) for name, answer in answers.items() for model in answer.models], as_json=as_json)


@app.command()
@command
def activate(
    name: Annotated[str, typer.Argument(help="Model name.")],
    version: Annotated[str, typer.Argument(help="Version to activate.")],
    expected_current: Annotated[str, typer.Option(help="Refuse unless this version is active now.")] = "",
    service: _Owner = "",
    as_json: AsJson = False,
) -> None:
    """Choose the version that answers requests that name none."""
    request = ActivateModelRequest(name, version, expected_current)
    service = service or _owner(name, version)
    active = call(ModelClient, service, lambda client: client.activate_model(request)).model
    _show([(service, active)], as_json=as_json)


@app.command()
@command
def rm(
    name: Annotated[str, typer.Argument(help="Model name.")],
    version: Annotated[str, typer.Argument(help="Version to delete; all of this name when empty.")] = "",
    *,
    active: Annotated[
        bool, typer.Option("--active", help="Delete the active version, too, which answers requests that name none.")
    ] = False,
    service: _Owner = "",
    as_json: AsJson = False,
) -> None:
    """Delete a version of a model, or all; one that comes with freerein, or that a fit or run needs, stays."""
    request = DeleteModelRequest(name, version, even_active=active)
    service = service or _owner(name, version)
    deleted = call(ModelClient, service, lambda client: client.delete_model(request)).models
    for ref in deleted:
        print_json({"service": service, **vars(ref)}) if as_json else typer.echo(f"Deleted {ref.name} {ref.version}.")


@app.command()
@command
def publish(
    run: Annotated[str, typer.Argument(help="Id of a ppo run that succeeded, or its first digits or readable name.")],
    name: Annotated[str, typer.Option(help="Model name; that of the run's task when empty.")] = "",
    as_json: AsJson = False,
) -> None:
    """Serve the policy of a ppo run by name, beside the other models of the imitation service."""
    request = PublishPolicyRequest(find(run, "orchestrator")[1], name)
    ref = call(ImitationClient, "imitation", lambda client: client.publish_policy(request)).model
    found = call(ModelClient, "imitation", lambda client: client.list_models(ListModelsRequest())).models
    _show([("imitation", model) for model in found if model.ref == ref], as_json=as_json)


@app.command()
@command
def export(
    name: Annotated[
        str,
        typer.Argument(metavar="NAME[@VERSION]", help="Model of the imitation service, or stored policy of ppo."),
    ],
    *,
    to: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write, new or empty.")],
    run: Annotated[bool, typer.Option("--run", help="NAME is the id of a ppo run that succeeded.")] = False,
    goal_text: Annotated[
        list[str] | None, typer.Option(metavar="TEXT", help="Further goal of a policy that follows texts; repeatable.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write a policy as a folder for other programs: weights, card, an ONNX graph, and how to run it.

    Needs no service, but the files of the model: the data directory. Takes half a minute.
    """
    settings = CliSettings()
    if run:
        name = find(name, "orchestrator")[1]
        source, data = settings.data_dir / "runs" / name / "artifacts", f"ppo run {name}"
    else:
        source, data = _policy_folder(settings, *name.partition("@")[::2]), f"stored policy {name}"
    exporter = import_module(f"{choose(['imitation'])['imitation']}.export")
    exporter.export_policy(source, to, data=data, goal_texts=goal_text or ())
    print_json({"folder": str(to)}) if as_json else typer.echo(f"{name} is in {to}; its README.txt says how to run it.")


def _policy_folder(settings: CliSettings, name: str, version: str) -> Path:
    """Returns the folder of a model of the imitation service, or of a stored policy; by default the active version."""
    check_name(name, field="name")
    for service in ("imitation", "orchestrator"):
        shipped = (settings.shipped_dir or CLONE_MODELS) / service
        store = ModelStore(settings.data_dir / "models" / service, shipped)
        if name in store.names() and (chosen := version or store.active_version(name)):
            return store.folder(ModelRef(name, chosen))
    raise NotFound(
        f"The policy must be a model of the imitation service, or a stored policy of ppo; {quoted(name)} is none that "
        "is active.",
        field="name",
        hint="`freerein models list --service imitation` names the models. With --run NAME is the id of a ppo run.",
    )


def _owner(name: str, version: str) -> str:
    """Returns the one service that has a model; an empty version is any."""
    answers, errors = call_each(_LEARNED, lambda client: client.list_models(ListModelsRequest()))
    wanted = (name, version) if version else (name,)
    owners = [
        service
        for service, answer in answers.items()
        if any((each.ref.name, each.ref.version)[: len(wanted)] == wanted for each in answer.models)
    ]
    if not owners:
        check_all_answer(errors)
        raise NotFound("There is no model of that name and version.", field="name", hint="See `freerein models list`.")
    if len(owners) > 1:
        raise InvalidInput(
            f"The service must be named where several have such a model; {', '.join(owners)} do.",
            field="service",
            hint=f"Write --service {owners[0]}.",
        )
    return owners[0]


def _show(models: Sequence[tuple[str, Model]], *, as_json: bool) -> None:
    documents = ({"service": service, **wire.to_json(model)} for service, model in models)
    now_ns = wall_clock.now_ns()
    rows = (
        (
            service,
            model.ref.name,
            model.ref.version,
            "active" if model.active else "",
            ago(model.time_ns, now_ns=now_ns) or "shipped",
            _dataset(model.card),
        )
        for service, model in models
    )
    columns = ("service", "model", "version", "", "made", "dataset")
    show_all(columns, rows, documents, as_json=as_json, last="cut")


def _dataset(card: Mapping[str, Any]) -> str:
    """Returns the training data of a model in one line: task, number of trajectories, dataset fingerprint."""
    data = card.get("data", "")
    if not isinstance(data, Mapping):
        return str(data)
    fingerprint = str(data.get("fingerprint", ""))[:_FINGERPRINT_DIGITS]
    count = f"{data['trajectories']} trajectories" if "trajectories" in data else ""
    return ", ".join(filter(None, (str(card.get("task", "")), count, fingerprint)))
