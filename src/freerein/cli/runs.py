"""`freerein runs`: started, listed, watched, cancelled, gone on with, and what came of them."""

import asyncio
import os
import sys
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from contextlib import aclosing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, BinaryIO, Literal, TypeVar

import typer

from freerein.cli import watching
from freerein.cli.configuring import Settings, configuration
from freerein.cli.output import AsJson, command, print_json, show_table
from freerein.cli.underway import steps_of

if TYPE_CHECKING:
    from freerein.clients import OrchestratorClient
    from freerein.types.orchestrator import Artifact, Run

T = TypeVar("T")

app = typer.Typer(
    help="Runs: collecting, training, distilling, evaluating; they outlive every process.", no_args_is_help=True
)

_Kind = Annotated[
    Literal["collect", "fit", "ppo", "distill", "evaluate", "pipeline"],
    typer.Argument(metavar="KIND", help="collect, fit, ppo, distill, evaluate or pipeline."),
]
_Config = Annotated[Path | None, typer.Option(metavar="FILE.json", help="The configuration; --set changes it.")]
_Key = Annotated[str, typer.Option(help="The same key and configuration is the same run, however often it is started.")]
_Watch = Annotated[bool, typer.Option("--watch/--no-watch", help="Wait for the end, and draw curves until then.")]
_Metrics = Annotated[list[str] | None, typer.Option("--metric", help="Draw this one; those that tell most otherwise.")]
_Id = Annotated[str, typer.Argument(metavar="ID", help="What `freerein runs list` lists.")]
_Name = Annotated[str, typer.Argument(metavar="NAME", help="Which one to fetch; without it they are listed.")]
_Out = Annotated[Path | None, typer.Option(metavar="FILE", help="Where to put it, `-` for stdout; NAME by default.")]

_STDOUT = Path("-")


@app.command()
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
    """Start a run."""
    from freerein.types.orchestrator import StartRunRequest

    request = StartRunRequest(kind, configuration(settings, config), key)

    async def ask(client: "OrchestratorClient") -> "Run":
        return (await client.start_run(request)).run

    _show_or_watch(asyncio.run(_call(ask)), watch=watch, as_json=as_json)


@app.command("list")
@command
def list_runs(as_json: AsJson = False) -> None:
    """List all runs, the newest first."""
    from freerein.types.orchestrator import ListRunsRequest

    async def ask(client: "OrchestratorClient") -> "tuple[Run, ...]":
        return (await client.list_runs(ListRunsRequest())).runs

    _show(asyncio.run(_call(ask)), as_json=as_json)


@app.command("watch")
@command
def watch_run(run: _Id, metrics: _Metrics = None, as_json: AsJson = False) -> None:
    """Follow a run to its end, with its curves."""
    _watch(run, metrics=metrics or None, as_json=as_json)


@app.command()
@command
def cancel(run: _Id, as_json: AsJson = False) -> None:
    """End a run; its last checkpoint stays."""
    from freerein.types.orchestrator import CancelRunRequest

    async def ask(client: "OrchestratorClient") -> "Run":
        return (await client.cancel_run(CancelRunRequest(run))).run

    _show([asyncio.run(_call(ask))], as_json=as_json)


@app.command()
@command
def resume(run: _Id, watch: _Watch = False, as_json: AsJson = False) -> None:
    """Go on with a run that failed or was cancelled, from its last checkpoint."""
    from freerein.types.orchestrator import ResumeRunRequest

    async def ask(client: "OrchestratorClient") -> "Run":
        return (await client.resume_run(ResumeRunRequest(run))).run

    _show_or_watch(asyncio.run(_call(ask)), watch=watch, as_json=as_json)


@app.command()
@command
def artifacts(run: _Id, name: _Name = "", out: _Out = None, as_json: AsJson = False) -> None:
    """List the files that a run has left behind, or fetch one."""
    if not name:
        _show_artifacts(asyncio.run(_call(lambda client: _artifacts(client, run))), as_json=as_json)
    elif out == _STDOUT:
        asyncio.run(_call(lambda client: _fetch(client, run, name, sys.stdout.buffer)))
    else:
        path = out or Path(name)
        size = asyncio.run(_call(lambda client: _download(client, run, name, path)))
        print_json({"file": str(path), "size": size}) if as_json else typer.echo(f"{size} bytes in {path}")


async def _artifacts(client: "OrchestratorClient", run_id: str) -> "tuple[Artifact, ...]":
    from freerein.types.orchestrator import ListArtifactsRequest

    return (await client.list_artifacts(ListArtifactsRequest(run_id))).artifacts


async def _download(client: "OrchestratorClient", run_id: str, name: str, path: Path) -> int:
    """Writes an artifact to a file, whole or not at all; returns its size in bytes."""
    from freerein.atomic_files import TEMP_SUFFIX

    unfinished = path.with_name(f".{path.name}.{os.getpid()}{TEMP_SUFFIX}")
    try:
        with unfinished.open("wb") as file:
            size = await _fetch(client, run_id, name, file)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return size


async def _fetch(client: "OrchestratorClient", run_id: str, name: str, file: BinaryIO) -> int:
    """Writes the parts of an artifact; returns its size in bytes."""
    from freerein.types.orchestrator import GetArtifactRequest

    size = 0
    async with aclosing(client.get_artifact(GetArtifactRequest(run_id, name))) as parts:
        async for part in parts:
            size += file.write(part.data)
    return size


def _show_or_watch(run: "Run", *, watch: bool, as_json: bool) -> None:
    if watch:
        _watch(run.id, as_json=as_json)
    else:
        _show([run], as_json=as_json)


def _watch(run_id: str, *, metrics: Sequence[str] | None = None, as_json: bool) -> None:
    """Shows a run until it ends.

    Raises:
        FailedPrecondition: It did not succeed.
    """
    name, way_back = f"run {run_id[:8]}", f"freerein runs watch {run_id}"
    run = watching.watch(_changes(run_id), name=name, way_back=way_back, metrics=metrics, as_json=as_json)
    if not as_json:
        _show([run], as_json=False)


async def _changes(run_id: str) -> "AsyncGenerator[Run, None]":
    from freerein.cli.connection import connect
    from freerein.cli.following import follow_run
    from freerein.clients import OrchestratorClient

    client = connect(OrchestratorClient, "orchestrator")
    async with client, aclosing(follow_run(client, run_id)) as runs:
        async for run in runs:
            yield run


async def _call(ask: "Callable[[OrchestratorClient], Awaitable[T]]") -> T:
    from freerein.cli.connection import connect
    from freerein.clients import OrchestratorClient

    async with connect(OrchestratorClient, "orchestrator") as client:
        return await ask(client)


def _show(runs: "Sequence[Run]", *, as_json: bool) -> None:
    from freerein import wire

    if as_json:
        for run in runs:
            print_json(wire.to_json(run))
        return
    rows = [
        (
            run.id,
            run.kind,
            run.state,
            steps_of(run),
            f"{run.model.name} {run.model.version}" if run.model else "",
            run.error or watching.figures(run),
        )
        for run in runs
    ]
    show_table(("run", "kind", "state", "steps", "model", "figures"), rows)


def _show_artifacts(found: "Sequence[Artifact]", *, as_json: bool) -> None:
    from freerein import wire

    if as_json:
        for artifact in found:
            print_json(wire.to_json(artifact))
        return
    show_table(("artifact", "bytes"), [(artifact.name, str(artifact.size)) for artifact in found])
