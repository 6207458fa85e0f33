"""`freerein fit`: starts a fit; `freerein jobs` does all else."""

import re
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Annotated

import typer

from freerein.cli.audit import Audit, check_cameras, read_answers
from freerein.cli.audit import audit as run_audit
from freerein.cli.audit import show as show_audit
from freerein.cli.commands.jobs import Watch, show_or_watch
from freerein.cli.connection import call
from freerein.cli.datasets import (
    Replace,
    check_no_path,
    dataset_root,
    imported_with_progress,
    recordings,
)
from freerein.cli.jobs.config_keys import KeysHelp
from freerein.cli.jobs.options import Settings, configuration
from freerein.cli.output import AsJson, command
from freerein.clients import FitClient
from freerein.data import ImageSource, Source
from freerein.data.lookup import unseen_cameras
from freerein.data.meta import read_spec
from freerein.errors import ServiceError, must_be
from freerein.types.common import ModelRef
from freerein.types.learning import Fit, GetFitRequest, StartFitRequest

app = typer.Typer(
    help="Start a fit of a model.",
    epilog="`freerein fit segmentation --help` has the keys of --set; `freerein jobs` does all else.",
    no_args_is_help=True,
    add_completion=False,
)

_ModelName = Annotated[str, typer.Option(help="Name of the model; `default` when empty.")]
_Recordings = Annotated[
    Path | None,
    typer.Option(
        "--recordings",
        metavar="DIR",
        help="Import a folder of trajectories, or a LeRobotDataset v3, first, as the dataset.",
    ),
]
_Phrases = Annotated[
    list[str] | None,
    typer.Option(help="Noun phrases of the goal texts, such as `a red block`; repeatable, or with commas."),
]
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
        dataset: Annotated[str, typer.Argument(help="Name of a dataset; with --recordings of the new one.")] = "",
        *,
        folder: _Recordings = None,
        replace: Replace = False,
        model_name: _ModelName = "",
        settings: Settings = None,
        watch: Watch = False,
        as_json: AsJson = False,
    ) -> None:
        name = _dataset_name(dataset, folder, f"Write freerein fit {service} DATASET, or --recordings DIR.")
        request = StartFitRequest(name, model_name, configuration(service, settings))
        source = recordings(folder) if folder else None
        with _imported(source, name, replaces=replace, as_json=as_json) if source else nullcontext():
            fit = call(FitClient, service, lambda client: client.start_fit(request)).fit
        _show(service, fit, watch=watch, as_json=as_json)


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
    model_name: _ModelName = "",
    settings: Settings = None,
    audit: Audit = None,
    watch: Watch = False,
    as_json: AsJson = False,
) -> None:
    """Fit a vision-language reward model to unlabelled images and the noun phrases of the goal texts."""
    hint = "Write freerein fit reward --images DIR --phrases 'a red ball' --phrases 'a blue ball'."
    name = _dataset_name(dataset, images, hint)
    answers = read_answers(audit) if audit else []  # refused before anything is done
    named = [phrase.strip() for given in phrases or () for phrase in given.split(",")]
    config = configuration("reward", settings) | ({"phrases": named} if named else {})
    if audit:
        check_cameras(config.get("cameras"))
    request = StartFitRequest(name, model_name, config)
    source = ImageSource(images) if images else None
    with _imported(source, name, replaces=replace, as_json=as_json) if source else nullcontext():
        fit = call(FitClient, "reward", lambda client: client.start_fit(request)).fit
    _show("reward", fit, watch=watch or bool(answers), as_json=as_json)
    if answers:
        fitted = call(FitClient, "reward", lambda client: client.get_fit(GetFitRequest(fit.id))).fit
        show_audit(run_audit(answers, fitted.model or ModelRef(fit.model_name)), as_json=as_json)


@contextmanager
def _imported(source: Source, name: str, *, replaces: bool, as_json: bool) -> Iterator[None]:
    """Imports trajectories as a dataset; undoes that where the fit is refused, unless it is queued."""
    with imported_with_progress(source, name, replaces=replaces, is_shown=not as_json) as warnings:
        contents = [f"Imported as {name}: {source.contents}."] if source.contents else []
        typer.echo("".join(f"{line}\n" for line in (*contents, *source.notes, *warnings)), nl=False, err=as_json)
        yield


def _show(service: str, fit: Fit, *, watch: bool, as_json: bool) -> None:
    """Shows a fit, after the cameras that it does not see, where its dataset is in this data directory."""
    with suppress(ServiceError):
        spec = read_spec(dataset_root(fit.dataset))
        note = unseen_cameras(tuple(spec.cameras), fit.config["cameras"]) if spec else ""
        typer.echo(f"{note}\n" if note and not as_json else "", nl=False)
    show_or_watch(service, fit, watch=watch, as_json=as_json)


def _dataset_name(given: str, folder: Path | None, hint: str) -> str:
    """Returns the name of a dataset: the given one, or one like that of the folder that it is imported from.

    Raises:
        InvalidInput: There is neither, or the name is a path.
    """
    if given or not folder:
        if not given:
            raise must_be("A dataset or a folder to import", "given", "neither", field="dataset", hint=hint)
        return check_no_path(given)
    return re.sub(r"[^a-z0-9._-]+", "-", folder.resolve().name.lower()).strip("._-")[:64] or "images"
