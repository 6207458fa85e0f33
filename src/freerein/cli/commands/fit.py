"""`freerein fit`: start, list, watch, report, cancel, resume and delete fits; their metrics."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from freerein import wire
from freerein.cli.commands.dataset import (
    Replace,
    check_no_path,
    dataset_root,
    imported_with_progress,
)
from freerein.cli.connection import call, call_each, check_all_answer, check_only_unavailable
from freerein.cli.jobs import display, fit_report
from freerein.cli.jobs.config_keys import KeysHelp
from freerein.cli.jobs.display import check_succeeded
from freerein.cli.jobs.ids import is_whole_id, short, whole_id
from freerein.cli.jobs.next_steps import after_fit, say_next_steps
from freerein.cli.jobs.options import FromStep, MaxRows, Settings, configuration
from freerein.cli.jobs.progress import metrics_text, steps_text
from freerein.cli.jobs.streams import follow_fit
from freerein.cli.output import AsJson, command, delete_each, print_json
from freerein.cli.tables import show_all, show_table
from freerein.cli.times import ago
from freerein.clients import FitClient, ModelClient, SegmentationClient
from freerein.data import ImageSource
from freerein.data.lookup import unseen_cameras
from freerein.data.meta import read_spec
from freerein.errors import InvalidInput, ServiceError
from freerein.jobs import wall_clock
from freerein.types.jobs import MetricRow
from freerein.types.learning import (
    CancelFitRequest,
    DeleteFitRequest,
    Fit,
    GetFitMetricsRequest,
    GetFitRequest,
    ListFitsRequest,
    ListModelsRequest,
    ResumeFitRequest,
    StartFitRequest,
)

app = typer.Typer(
    help="Fits of models.",
    epilog="`freerein fit segmentation --help` has the keys of --set; so has the help of imitation and reward.",
    no_args_is_help=True,
    add_completion=False,
)

_Service = Annotated[str, typer.Option(help="Service that fits; all when empty.")]
_Id = Annotated[
    str, typer.Argument(metavar="ID", help="Id of the fit, its first digits or readable name; see `freerein fit list`.")
]

_Phrases = Annotated[
    list[str] | None,
    typer.Option(help="Noun phrases of the goal texts, such as `a red block`; repeatable, or with commas."),
]
_WatchEnd = Annotated[bool, typer.Option("--watch", help="Wait for the end and draw the curves.")]

_SERVICES = ("segmentation", "imitation", "reward")
_EXPLANATIONS = {
    "segmentation": "Fit a skill segmentation model to demonstrations tagged with the skills that occur.",
    "imitation": "Fit a policy to a dataset: the dissertation's goal images by default, `--set method=goal_cloning` "
    "to reach more, `inverse_model` for the baseline without memory, `skills` or `skill_cloning` for recipes of "
    "skills, `language` for language goals.",
}


def _add_start(service: str, explanation: str) -> None:
    """Adds the command that starts a fit of a service."""

    @app.command(service, help=explanation, cls=KeysHelp)
    @command
    def start(
        dataset: Annotated[str, typer.Argument(help="Name of a dataset in the data directory.")],
        model_name: Annotated[str, typer.Option(help="Name of the model; `default` when empty.")] = "",
        settings: Settings = None,
        watch: _WatchEnd = False,
        as_json: AsJson = False,
    ) -> None:
        request = StartFitRequest(check_no_path(dataset), model_name, configuration(settings))
        fit = call(FitClient, service, lambda client: client.start_fit(request)).fit
        _say_cameras(fit, as_json=as_json)
        _show_or_watch(service, fit, watch=watch, as_json=as_json)


for _service, _explanation in _EXPLANATIONS.items():
    _add_start(_service, _explanation)


@app.command(cls=KeysHelp)
@command
def reward(
    dataset: Annotated[str, typer.Argument(help="Name of a dataset; with --images of the new one.")] = "",
    *,
    images: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Import the images of a folder first, as the dataset; all get the shape of the first."
        ),
    ] = None,
    phrases: _Phrases = None,
    replace: Replace = False,
    model_name: Annotated[str, typer.Option(help="Name of the model; `default` when empty.")] = "",
    settings: Settings = None,
    watch: _WatchEnd = False,
    as_json: AsJson = False,
) -> None:
    """Fit a vision-language reward model to unlabelled images and the noun phrases of the goal texts."""
    name = dataset or (_dataset_name(images) if images else "")
    if not name:
        raise InvalidInput(
            "A dataset or --images must be given; got neither.",
            field="dataset",
            hint="Write freerein fit reward --images DIR --phrases 'a red ball' --phrases 'a blue ball'.",
        )
    named = [phrase.strip() for given in phrases or () for phrase in given.split(",")]
    config = configuration(settings) | ({"phrases": named} if named else {})
    request = StartFitRequest(check_no_path(name), model_name, config)
    with _imported(images, name, replaces=replace, as_json=as_json) if images else nullcontext():
        fit = call(FitClient, "reward", lambda client: client.start_fit(request)).fit
    _say_cameras(fit, as_json=as_json)
    _show_or_watch("reward", fit, watch=watch, as_json=as_json)


@contextmanager
def _imported(images: Path, name: str, *, replaces: bool, as_json: bool) -> Iterator[None]:
    """Imports a folder of images as a dataset; undoes that where the fit is refused, unless it is queued."""
    source = ImageSource(images)
    with imported_with_progress(source, name, replaces=replaces, is_shown=not as_json):
        typer.echo("".join(f"{note}\n" for note in source.notes if not as_json), nl=False)
        yield


def _say_cameras(fit: Fit, *, as_json: bool) -> None:
    """Says which cameras of the dataset a fit does not see, where the dataset is in this data directory."""
    with suppress(ServiceError):
        spec = read_spec(dataset_root(fit.dataset))
        note = unseen_cameras(tuple(spec.cameras), fit.config["cameras"]) if spec else ""
        typer.echo(f"{note}\n" if note and not as_json else "", nl=False)


def _dataset_name(folder: Path) -> str:
    """Returns a valid name of a dataset, like that of a folder."""
    return re.sub(r"[^a-z0-9._-]+", "-", folder.resolve().name.lower()).strip("._-")[:64] or "images"


@app.command("list")
@command
def list_fits(service: _Service = "", as_json: AsJson = False) -> None:
    """List all fits, newest first."""
    answers, errors = call_each(FitClient, [service] if service else list(_SERVICES), _all_fits)
    check_only_unavailable(errors)
    _show([(name, fit) for name, fits in answers.items() for fit in fits], as_json=as_json)


@app.command()
@command
def watch(fit: _Id, service: _Service = "", as_json: AsJson = False) -> None:
    """Watch a fit to its end, with its curves."""
    _watch(*_find(fit, service), as_json=as_json)


@app.command()
@command
def metrics(
    fit: _Id, service: _Service = "", *, from_step: FromStep = 0, max_rows: MaxRows = 1000, as_json: AsJson = False
) -> None:
    """Print the metrics of a fit."""
    found, fit_id = _find(fit, service)
    rows = call(FitClient, found, lambda client: _rows(client, GetFitMetricsRequest(fit_id, from_step, max_rows)))
    display.show_metrics(rows, as_json=as_json)


@app.command()
@command
def report(fit: _Id, as_json: AsJson = False) -> None:
    """Show what a segmentation fit is worth: tags of held-out trajectories, and frame accuracy where there are labels.

    Average precision of tags is that of the model card. Frame accuracy is measured here, on trajectories with true
    labels (`freerein dataset label`), which no fit sees.
    """
    _report(_find(fit, "segmentation")[1], as_json=as_json)


def _report(fit_id: str, *, as_json: bool) -> None:
    fit = call(FitClient, "segmentation", lambda client: client.get_fit(GetFitRequest(fit_id))).fit
    check_succeeded(f"fit {short(fit_id)}", fit)
    card = _card("segmentation", fit)
    root = dataset_root(fit.dataset)
    items = fit_report.labelled_trajectories(root)
    accuracy = None
    if items:
        accuracy = call(
            SegmentationClient,
            "segmentation",
            lambda client: fit_report.labelled_accuracy(client, fit, root, items),
        )
    if as_json:
        figures = {"fit": fit_id, **fit_report.card_figures(card)}
        print_json(figures | {"labelled": asdict(accuracy) if accuracy else None})
    else:
        _show_report(card, accuracy)


def _show_report(card: Mapping[str, Any], accuracy: fit_report.LabelledAccuracy | None) -> None:
    rows = [
        (f"tag average precision, {skill}", f"{each['average_precision']:.3f}", f"{each['chance']:.3f}")
        for skill, each in card.get("tag_average_precision", {}).items()
    ]
    mean = card.get("figures", {}).get("tag_average_precision")
    if mean is not None:
        rows.append((f"tag average precision, mean on {card.get('held_out')} held-out trajectories", f"{mean:.3f}", ""))
    if accuracy:
        name = f"frame accuracy, {accuracy.trajectories} labelled trajectories"
        rows.append((name, f"{accuracy.frame_accuracy:.3f}", f"{accuracy.random_cls_accuracy:.3f}"))
    show_table(("", "model", "chance"), rows)
    _show_warnings(card)


def _card(service: str, fit: Fit) -> dict[str, Any]:
    """Returns the card of the model that a fit made; empty without."""
    models = call(ModelClient, service, lambda client: client.list_models(ListModelsRequest())).models
    return next((dict(model.card) for model in models if model.ref == fit.model), {})


def _show_warnings(card: Mapping[str, Any]) -> None:
    for warning in card.get("warnings", ()):
        typer.echo(f"warning: {warning}")
    for note in card.get("notes", ()):
        typer.echo(note)


@app.command()
@command
def cancel(fit: _Id, service: _Service = "", as_json: AsJson = False) -> None:
    """Cancel a fit; its last checkpoint is kept."""
    found, fit_id = _find(fit, service)
    cancelled = call(FitClient, found, lambda client: client.cancel_fit(CancelFitRequest(fit_id))).fit
    _show([(found, cancelled)], as_json=as_json)


@app.command()
@command
def rm(
    fits: Annotated[list[str], typer.Argument(metavar="ID...", help="Ids of fits, their first digits or names.")],
    service: _Service = "",
    as_json: AsJson = False,
) -> None:
    """Delete fits that have ended, with their checkpoints; the models that they made stay."""
    services = {fit_id: found for found, fit_id in (_find(fit, service) for fit in fits)}

    def delete(fit_id: str) -> None:
        call(FitClient, services[fit_id], lambda client: client.delete_fit(DeleteFitRequest(fit_id)))

    delete_each(list(services), delete, noun="fit", as_json=as_json, shown=short)


@app.command()
@command
def resume(
    fit: _Id,
    service: _Service = "",
    *,
    watch: _WatchEnd = False,
    as_json: AsJson = False,
) -> None:
    """Resume a failed or cancelled fit from its last checkpoint."""
    found, fit_id = _find(fit, service)
    resumed = call(FitClient, found, lambda client: client.resume_fit(ResumeFitRequest(fit_id))).fit
    _show_or_watch(found, resumed, watch=watch, as_json=as_json)


def _find(fit: str, service: str) -> tuple[str, str]:
    """Returns the service and the id of the fit that is meant; an empty service is looked for."""
    if is_whole_id(fit):
        return service or _service_of(fit), fit
    answers, errors = call_each(FitClient, [service] if service else list(_SERVICES), _all_fits)
    services = {each.id: name for name, fits in answers.items() for each in fits}
    if not any(each.startswith(fit) for each in services):
        check_all_answer(errors)
    fit_id = whole_id(fit, list(services), list_command="freerein fit list")
    return services[fit_id], fit_id


def _service_of(fit_id: str) -> str:
    """Returns the service that knows a fit; raises as `call_each` where none does."""
    answers, _ = call_each(FitClient, list(_SERVICES), lambda client: client.get_fit(GetFitRequest(fit_id)))
    return next(iter(answers))


async def _all_fits(client: FitClient) -> list[Fit]:
    page = await client.list_fits(ListFitsRequest())
    fits = list(page.fits)
    while page.next_page_token:
        page = await client.list_fits(ListFitsRequest(page_token=page.next_page_token))
        fits += page.fits
    return fits


async def _rows(client: FitClient, request: GetFitMetricsRequest) -> Sequence[MetricRow]:
    return (await client.get_fit_metrics(request)).rows


def _show_or_watch(service: str, fit: Fit, *, watch: bool, as_json: bool) -> None:
    if watch:
        _watch(service, fit.id, as_json=as_json)
    else:
        _show([(service, fit)], as_json=as_json)


def _watch(service: str, fit_id: str, *, as_json: bool) -> None:
    """Shows a fit until it ends; raises FailedPrecondition when it did not succeed."""
    fit = display.watch(
        FitClient,
        service,
        lambda client: follow_fit(client, fit_id),
        lambda client: _rows(client, GetFitMetricsRequest(fit_id)),
        name=f"fit {short(fit_id)}",
        command=f"freerein fit watch {short(fit_id)}",
        as_json=as_json,
    )
    if not as_json:
        _show([(service, fit)], as_json=False)
        if service == "segmentation":
            _report(fit.id, as_json=False)
        else:
            _show_warnings(_card(service, fit))
        say_next_steps(after_fit(service, fit))


def _show(fits: Sequence[tuple[str, Fit]], *, as_json: bool) -> None:
    """Prints fits and their services."""
    documents = ({"service": service, **wire.to_json(fit)} for service, fit in fits)
    now_ns = wall_clock.now_ns()
    rows = (
        (
            short(fit.id),
            service,
            fit.dataset,
            fit.state,
            ago(fit.time_ns, now_ns=now_ns),
            str(fit.step) if fit.state == "succeeded" else steps_text(fit),
            f"{fit.model.name} {fit.model.version}" if fit.model else fit.model_name,
            fit.error or metrics_text(fit),
        )
        for service, fit in fits
    )
    columns = ("fit", "service", "dataset", "state", "changed", "steps", "model", "metrics")
    show_all(columns, rows, documents, as_json=as_json, last="cut")
