"""`freerein jobs`: what is done with fits and runs, whichever service has them."""

import os
import sys
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import aclosing
from functools import partial
from pathlib import Path
from typing import Annotated, Any, BinaryIO, TypeVar

import typer

from freerein import wire
from freerein.atomic_files import TEMP_SUFFIX
from freerein.cli.connection import call, call_each, check_all_answer, check_only_unavailable
from freerein.cli.jobs import display, fit_report
from freerein.cli.jobs.ids import is_whole_id, matching, short, whole_id
from freerein.cli.jobs.job_calls import CLIENTS, JobClient, all_jobs, ask, metric_rows, noun_of
from freerein.cli.jobs.next_steps import next_steps, say_next_steps
from freerein.cli.jobs.options import FromStep, MaxRows
from freerein.cli.jobs.progress import Job, metrics_text, steps_text
from freerein.cli.output import AsJson, command, delete_each, print_json
from freerein.cli.tables import show_all
from freerein.cli.times import ago
from freerein.clients import FitClient, OrchestratorClient
from freerein.errors import InvalidInput, must_be
from freerein.jobs import wall_clock
from freerein.jobs.names import job_name
from freerein.types.learning import Fit
from freerein.types.orchestrator import (
    GetArtifactRequest,
    GetRunRequest,
    ListArtifactsRequest,
    Run,
    StartRunRequest,
)

T = TypeVar("T")

app = typer.Typer(
    help="Fits and runs: list, watch, resume and delete them.", no_args_is_help=True, add_completion=False
)

Watch = Annotated[bool, typer.Option("--watch/--no-watch", help="Wait for the end and draw the curves.")]
_Service = Annotated[
    str, typer.Option(help="Its service: segmentation, imitation, reward, or orchestrator for a run; all when empty.")
]
_ID_HELP = "Id of a fit or run, its first digits or readable name; see `freerein jobs list`."
_Id = Annotated[str, typer.Argument(metavar="ID", help=_ID_HELP)]
_Metrics = Annotated[
    list[str] | None, typer.Option("--metric", help="Metric to draw; repeatable. Default: the most relevant ones.")
]
_Iterations = Annotated[
    int | None, typer.Option(min=1, help="Train a ppo run that has succeeded on: so many iterations, as a new run.")
]
_Name = Annotated[str, typer.Argument(metavar="NAME", help="Artifact to fetch; without it, all are listed.")]
_Out = Annotated[Path | None, typer.Option(metavar="FILE", help="Output file or folder, `-` for stdout; default NAME.")]
_STDOUT = Path("-")


@app.command("list")
@command
def list_jobs(service: _Service = "", as_json: AsJson = False) -> None:
    """List fits and runs, newest first, by service."""
    answers, errors = call_each(_clients(service), all_jobs)
    check_only_unavailable(errors)
    show_jobs([(name, job) for name, jobs in answers.items() for job in jobs], as_json=as_json)


@app.command()
@command
def watch(job: _Id, service: _Service = "", metrics: _Metrics = None, as_json: AsJson = False) -> None:
    """Watch a fit or run to its end, with its curves."""
    _watch(*find(job, service), metrics=metrics or None, as_json=as_json)


@app.command()
@command
def metrics(
    job: _Id, service: _Service = "", *, from_step: FromStep = 0, max_rows: MaxRows = 1000, as_json: AsJson = False
) -> None:
    """Print the metrics of a fit or run."""
    found, job_id = find(job, service)
    rows = _ask(found, lambda client: metric_rows(client, job_id, from_step, max_rows))
    display.show_metrics(rows, as_json=as_json)


@app.command()
@command
def report(fit: _Id, as_json: AsJson = False) -> None:
    """Show what a segmentation fit is worth: tags of held-out trajectories, and frame accuracy where there are labels.

    Average precision of tags is that of the model card. Frame accuracy is measured here, on trajectories with true
    labels (`freerein dataset label`), which no fit sees.
    """
    fit_report.show(find(fit, "segmentation")[1], as_json=as_json)


@app.command()
@command
def cancel(job: _Id, service: _Service = "", as_json: AsJson = False) -> None:
    """Cancel a fit or run; its last checkpoint is kept."""
    found, job_id = find(job, service)
    show_jobs([(found, _ask(found, lambda client: ask(client, "cancel", job_id)))], as_json=as_json)


@app.command()
@command
def resume(
    job: _Id,
    service: _Service = "",
    *,
    iterations: _Iterations = None,
    watch: Watch = False,
    as_json: AsJson = False,
) -> None:
    """Resume a failed or cancelled fit or run from its last checkpoint; with --iterations, train a ppo run on."""
    found, job_id = find(job, service)
    if iterations and found != "orchestrator":
        raise must_be("The job", "a ppo run", f"a fit of {found}", field="iterations", hint="Leave --iterations out.")
    if iterations:
        resumed = _ask("orchestrator", lambda client: _train_on(client, job_id, iterations))
    else:
        resumed = _ask(found, lambda client: ask(client, "resume", job_id))
    show_or_watch(found, resumed, watch=watch, as_json=as_json)


@app.command()
@command
def rm(
    jobs: Annotated[list[str], typer.Argument(metavar="ID...", help="Ids, their first digits or readable names.")],
    service: _Service = "",
    as_json: AsJson = False,
) -> None:
    """Delete fits and runs that have ended, with checkpoints and artifacts; models and datasets that they made stay."""
    for found, job_id in dict.fromkeys(find(job, service) for job in jobs):
        delete_each([job_id], partial(_delete, found), noun=noun_of(found), as_json=as_json, shown=short)


@app.command()
@command
def artifacts(run: _Id, name: _Name = "", out: _Out = None, as_json: AsJson = False) -> None:
    """List the artifacts of a run, or fetch one."""
    run_id = find(run, "orchestrator")[1]
    if not name:
        _list_artifacts(run_id, as_json=as_json)
    elif out == _STDOUT:
        _ask("orchestrator", lambda client: _fetch(client, run_id, name, sys.stdout.buffer))
    else:
        path = out / name if out and out.is_dir() else out or Path(name)
        size = _ask("orchestrator", lambda client: _download(client, run_id, name, path))
        print_json({"file": str(path), "size": size}) if as_json else typer.echo(f"{size} bytes in {path}")


def find(job: str, service: str) -> tuple[str, str]:
    """Returns the service and the id of the job that is meant; an empty service is looked for."""
    clients = _clients(service)
    if is_whole_id(job):
        if len(clients) == 1:
            return service, job
        answers, _ = call_each(clients, lambda client: ask(client, "get", job))
        return next(iter(answers)), job
    found, errors = call_each(clients, all_jobs)
    services = {each.id: name for name, jobs in found.items() for each in jobs}
    if not matching(job, services):
        check_all_answer(errors)
    job_id = whole_id(job, services)
    return services[job_id], job_id


def show_or_watch(service: str, job: Job, *, watch: bool, as_json: bool) -> None:
    """Shows a job as it is, or until it ends."""
    if watch:
        _watch(service, job.id, as_json=as_json)
    else:
        show_jobs([(service, job)], as_json=as_json)


def show_jobs(jobs: Sequence[tuple[str, Job]], *, as_json: bool) -> None:
    """Prints jobs and their services."""
    documents = ({"service": service, **wire.to_json(job)} for service, job in jobs)
    now_ns = wall_clock.now_ns()
    rows = (
        (
            short(job.id),
            _name(service, job),
            job.state,
            ago(job.time_ns, now_ns=now_ns),
            str(job.step) if job.state == "succeeded" else steps_text(job),
            f"{job.model.name} {job.model.version}" if job.model else getattr(job, "model_name", ""),
            job.error or metrics_text(job),
        )
        for service, job in jobs
    )
    show_all(
        ("job", "name", "state", "changed", "steps", "model", "metrics"), rows, documents, as_json=as_json, last="cut"
    )


def _ask(service: str, use: Callable[[Any], Awaitable[T]]) -> T:
    return call(CLIENTS.get(service, FitClient), service, use)


def _delete(service: str, job_id: str) -> None:
    _ask(service, lambda client: ask(client, "delete", job_id))


def _clients(service: str) -> Mapping[str, type[JobClient]]:
    """Returns the client of a service, of each with fits where these are meant, or of each where none is named."""
    if service == "fits":  # as in the commands of earlier versions, which named no run
        return {name: client for name, client in CLIENTS.items() if client is FitClient}
    return {service: CLIENTS.get(service, FitClient)} if service else CLIENTS


def _name(service: str, job: Job) -> str:
    """Returns a job's readable name, without its digits."""
    if isinstance(job, Run):
        return job_name(job.kind, job.config)
    return job_name(service, {"dataset": job.dataset, "model_name": job.model_name})


def _watch(service: str, job_id: str, *, metrics: Sequence[str] | None = None, as_json: bool) -> None:
    """Shows a job until it ends; raises FailedPrecondition when it did not succeed."""
    job = display.watch(service, job_id, metrics=metrics, as_json=as_json)
    if as_json:
        return
    show_jobs([(service, job)], as_json=False)
    if service == "segmentation":
        fit_report.show(job.id, as_json=False)
    elif isinstance(job, Fit):
        fit_report.show_warnings(fit_report.card_of(service, job))
    say_next_steps(next_steps(service, job))


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


def _list_artifacts(run_id: str, *, as_json: bool) -> None:
    found = _ask("orchestrator", lambda client: client.list_artifacts(ListArtifactsRequest(run_id))).artifacts
    now_ns = wall_clock.now_ns()
    rows = ((each.name, str(each.size), ago(each.time_ns, now_ns=now_ns)) for each in found)
    show_all(("artifact", "bytes", "changed"), rows, map(wire.to_json, found), as_json=as_json)


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
