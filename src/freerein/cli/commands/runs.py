"""`freerein runs`: start, list, watch, cancel, resume and delete runs; their metrics and artifacts."""

import os
import sys
from collections.abc import Awaitable, Callable, Sequence
from contextlib import aclosing
from pathlib import Path
from typing import Annotated, BinaryIO, TypeVar, cast, get_args

import typer

from freerein import wire
from freerein.atomic_files import TEMP_SUFFIX
from freerein.cli.connection import call
from freerein.cli.jobs import display
from freerein.cli.jobs.config_keys import KeysHelp
from freerein.cli.jobs.ids import is_whole_id, short, whole_id
from freerein.cli.jobs.next_steps import after_run, say_next_steps
from freerein.cli.jobs.options import FromStep, MaxRows, Settings, configuration
from freerein.cli.jobs.progress import metrics_text, steps_text
from freerein.cli.jobs.streams import follow_run
from freerein.cli.output import AsJson, command, delete_each, print_json
from freerein.cli.tables import show_all
from freerein.cli.times import ago
from freerein.clients import OrchestratorClient
from freerein.errors import InvalidInput
from freerein.jobs import wall_clock
from freerein.jobs.names import job_name
from freerein.types.jobs import MetricRow
from freerein.types.orchestrator import (
    CancelRunRequest,
    DeleteRunRequest,
    GetArtifactRequest,
    GetMetricsRequest,
    GetRunRequest,
    ListArtifactsRequest,
    ListRunsRequest,
    ResumeRunRequest,
    Run,
    RunKind,
    StartRunRequest,
)

T = TypeVar("T")

app = typer.Typer(
    help="Runs: collect, fit, label, ppo, distill, evaluate, pipelines and skills; they survive crashes.",
    no_args_is_help=True,
    add_completion=False,
)


def _known_kind(kind: str) -> str:
    if kind not in get_args(RunKind):
        raise typer.BadParameter(f"The kind must be one of {', '.join(get_args(RunKind))}; got another.")
    return kind


_Kind = Annotated[
    str,
    typer.Argument(
        metavar="KIND",
        callback=_known_kind,
        help="collect, fit, label, ppo, distill, evaluate, pipeline or skills.",
    ),
]
_Config = Annotated[Path | None, typer.Option(metavar="FILE.json", help="Configuration file; --set overrides it.")]
_Key = Annotated[str, typer.Option(help="Idempotency key: the same key and configuration is the same run.")]
_Watch = Annotated[bool, typer.Option("--watch/--no-watch", help="Wait for the end and draw the curves.")]
_Metrics = Annotated[
    list[str] | None, typer.Option("--metric", help="Metric to draw; repeatable. Default: the most relevant ones.")
]
_Id = Annotated[
    str,
    typer.Argument(metavar="ID", help="Id of the run, its first digits or readable name; see `freerein runs list`."),
]
_Name = Annotated[str, typer.Argument(metavar="NAME", help="Artifact to fetch; without it, all are listed.")]
_Out = Annotated[Path | None, typer.Option(metavar="FILE", help="Output file or folder, `-` for stdout; default NAME.")]

_Iterations = Annotated[
    int | None, typer.Option(min=1, help="Train a ppo run that has succeeded on: so many iterations, as a new run.")
]

_STDOUT = Path("-")


@app.command(cls=KeysHelp)
@command
def start(
    kind: _Kind,
    *,
    settings: Settings = None,
    config: _Config = None,
    key: _Key = "",
    watch: _Watch = False,
    as_json: AsJson = False,
) -> None:
    """Start a run; `freerein runs start KIND --help` has the keys of one kind."""
    request = StartRunRequest(cast(RunKind, kind), configuration(settings, config), key)
    _show_or_watch(_ask(lambda client: client.start_run(request)).run, watch=watch, as_json=as_json)


@app.command("list")
@command
def list_runs(as_json: AsJson = False) -> None:
    """List all runs, newest first."""
    _show(_ask(_all_runs), as_json=as_json)


@app.command("watch")
@command
def watch_run(run: _Id, metrics: _Metrics = None, as_json: AsJson = False) -> None:
    """Watch a run to its end, with its curves."""
    _watch(whole_run(run), metrics=metrics or None, as_json=as_json)


@app.command()
@command
def metrics(run: _Id, from_step: FromStep = 0, max_rows: MaxRows = 1000, as_json: AsJson = False) -> None:
    """Print the metrics of a run."""
    request = GetMetricsRequest(whole_run(run), from_step, max_rows)
    display.show_metrics(_ask(lambda client: _rows(client, request)), as_json=as_json)


@app.command()
@command
def cancel(run: _Id, as_json: AsJson = False) -> None:
    """Cancel a run; its last checkpoint is kept."""
    run_id = whole_run(run)
    _show([_ask(lambda client: client.cancel_run(CancelRunRequest(run_id))).run], as_json=as_json)


@app.command()
@command
def resume(run: _Id, *, iterations: _Iterations = None, watch: _Watch = False, as_json: AsJson = False) -> None:
    """Resume a failed or cancelled run from its last checkpoint; with --iterations, train a ppo run on."""
    run_id = whole_run(run)
    if iterations:
        resumed = _ask(lambda client: _train_on(client, run_id, iterations))
    else:
        resumed = _ask(lambda client: client.resume_run(ResumeRunRequest(run_id))).run
    _show_or_watch(resumed, watch=watch, as_json=as_json)


@app.command()
@command
def rm(
    runs: Annotated[list[str], typer.Argument(metavar="ID...", help="Ids of runs, their first digits or names.")],
    as_json: AsJson = False,
) -> None:
    """Delete runs that have ended, with their artifacts; models and datasets that they made stay."""

    def delete(run_id: str) -> None:
        _ask(lambda client: client.delete_run(DeleteRunRequest(run_id)))

    delete_each(list(dict.fromkeys(map(whole_run, runs))), delete, noun="run", as_json=as_json, shown=short)


@app.command()
@command
def artifacts(run: _Id, name: _Name = "", out: _Out = None, as_json: AsJson = False) -> None:
    """List the artifacts of a run, or fetch one."""
    run_id = whole_run(run)
    if not name:
        _list_artifacts(run_id, as_json=as_json)
    elif out == _STDOUT:
        _ask(lambda client: _fetch(client, run_id, name, sys.stdout.buffer))
    else:
        path = out / name if out and out.is_dir() else out or Path(name)
        size = _ask(lambda client: _download(client, run_id, name, path))
        print_json({"file": str(path), "size": size}) if as_json else typer.echo(f"{size} bytes in {path}")


def whole_run(run: str) -> str:
    """Returns the id of the run that is meant by an id, its first digits or a readable name."""
    if is_whole_id(run):
        return run
    return whole_id(run, [each.id for each in _ask(_all_runs)], list_command="freerein runs list")


async def _train_on(client: OrchestratorClient, run_id: str, iterations: int) -> Run:
    """Starts a run that goes on with a ppo run that has succeeded, with its configuration."""
    run = (await client.get_run(GetRunRequest(run_id))).run
    if run.kind != "ppo":
        raise InvalidInput(
            f"--iterations trains a ppo run on; this run is of kind {run.kind}.",
            field="iterations",
            hint="Leave --iterations out to resume it, or start a new run.",
        )
    own = {"init_from": "", "resume_from": run_id, "iterations": iterations}
    return (await client.start_run(StartRunRequest("ppo", {**run.config, **own}))).run


async def _all_runs(client: OrchestratorClient) -> list[Run]:
    page = await client.list_runs(ListRunsRequest())
    runs = list(page.runs)
    while page.next_page_token:
        page = await client.list_runs(ListRunsRequest(page_token=page.next_page_token))
        runs += page.runs
    return runs


async def _rows(client: OrchestratorClient, request: GetMetricsRequest) -> Sequence[MetricRow]:
    return (await client.get_metrics(request)).rows


async def _download(client: OrchestratorClient, run_id: str, name: str, path: Path) -> int:
    """Writes an artifact to a file, whole or not at all; returns its size in bytes."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}{TEMP_SUFFIX}")
    try:
        with unfinished.open("wb") as file:
            size = await _fetch(client, run_id, name, file)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return size


async def _fetch(client: OrchestratorClient, run_id: str, name: str, file: BinaryIO) -> int:
    """Writes the parts of an artifact; returns its size in bytes."""
    size = 0
    async with aclosing(client.get_artifact(GetArtifactRequest(run_id, name))) as parts:
        async for part in parts:
            size += file.write(part.data)
    return size


def _show_or_watch(run: Run, *, watch: bool, as_json: bool) -> None:
    if watch:
        _watch(run.id, as_json=as_json)
    else:
        _show([run], as_json=as_json)


def _watch(run_id: str, *, metrics: Sequence[str] | None = None, as_json: bool) -> None:
    """Shows a run until it ends; raises FailedPrecondition when it did not succeed."""
    run = display.watch(
        OrchestratorClient,
        "orchestrator",
        lambda client: follow_run(client, run_id),
        lambda client: _rows(client, GetMetricsRequest(run_id)),
        name=f"run {short(run_id)}",
        command=f"freerein runs watch {short(run_id)}",
        metrics=metrics,
        as_json=as_json,
    )
    if not as_json:
        _show([run], as_json=False)
        say_next_steps(after_run(run))


def _ask(use: Callable[[OrchestratorClient], Awaitable[T]]) -> T:
    return call(OrchestratorClient, "orchestrator", use)


def _show(runs: Sequence[Run], *, as_json: bool) -> None:
    now_ns = wall_clock.now_ns()
    rows = (
        (
            short(run.id),
            job_name(run.kind, run.config),
            run.state,
            ago(run.time_ns, now_ns=now_ns),
            str(run.step) if run.state == "succeeded" else steps_text(run),
            f"{run.model.name} {run.model.version}" if run.model else "",
            run.error or metrics_text(run),
        )
        for run in runs
    )
    columns = ("run", "name", "state", "changed", "steps", "model", "metrics")
    show_all(columns, rows, map(wire.to_json, runs), as_json=as_json, last="cut")


def _list_artifacts(run_id: str, *, as_json: bool) -> None:
    found = _ask(lambda client: client.list_artifacts(ListArtifactsRequest(run_id))).artifacts
    now_ns = wall_clock.now_ns()
    rows = ((each.name, str(each.size), ago(each.time_ns, now_ns=now_ns)) for each in found)
    show_all(("artifact", "bytes", "changed"), rows, map(wire.to_json, found), as_json=as_json)
