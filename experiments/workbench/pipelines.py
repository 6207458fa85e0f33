"""Pipelines of the orchestrator on services of their own: what an arm measures is what a user would get.

<folder>/data/   the services' data directory; without its datasets once the pipeline is done
"""

import asyncio
import json
import os
import shutil
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import aclosing
from pathlib import Path
from typing import Any

from experiments.workbench.cache_paths import cache_path
from experiments.workbench.locks import locked
from freerein.cli.connection import channel_to
from freerein.cli.jobs.display import check_succeeded
from freerein.cli.jobs.streams import follow_run
from freerein.cli.settings import CliSettings
from freerein.clients import OrchestratorClient
from freerein.jobs.child import stop_on_sigterm
from freerein.jobs.store import id_of
from freerein.stack import Stack, choose, free_ports, isolated_environ
from freerein.types.orchestrator import StartRunRequest

Step = Mapping[str, Any]
"""A step of a pipeline: `name`, `kind` and `config`."""

Trials = Mapping[str, Sequence[Mapping[str, Any]]]
"""Values of the trials of each evaluation, by the name of its step."""

_SERVICES = ("sim", "segmentation", "imitation", "reward", "orchestrator")
_READY_TIMEOUT_S = 300.0
_POLL_S = 0.2
_NAME = "arm"


def step(name: str, kind: str, **config: Any) -> Step:
    """Returns a step of a pipeline."""
    return {"name": name, "kind": kind, "config": config}


def fit_step(name: str, service: str, dataset: str, **config: Any) -> Step:
    """Returns a step that fits a service's model to a dataset."""
    return step(name, "fit", service=service, dataset=dataset, config=config)


def run_pipeline(
    steps: Sequence[Step],
    folder: Path,
    on_progress: Callable[[], None],
    *,
    source: Path | None = None,
    keeps_datasets: bool = False,
    modules: Mapping[str, str] = {},
    then: Callable[[Mapping[str, str]], Awaitable[None]] | None = None,
) -> Trials | None:
    """Runs a pipeline, or resumes it; returns what its evaluations measured, None when SIGTERM stopped it.

    Args:
        steps: Its steps.
        folder: The arm's.
        on_progress: Called now and then.
        source: Folder of a pipeline that is done: the services begin with its datasets and models.
        keeps_datasets: Whether another pipeline needs its datasets.
        modules: Modules of services that others take the place of, by service.
        then: Awaited once the pipeline is done, with the addresses of the services, which still run.

    Raises:
        FailedPrecondition: A step failed.
    """
    data = folder / "data"
    if source:
        for part in ("datasets", "models"):
            _link_folder(source / "data" / part, data / part)
    with stop_on_sigterm() as is_stopped:
        services = {**choose(_SERVICES), **modules}
        running = _run_to_its_end(services, {"steps": list(steps)}, data, on_progress, is_stopped, then=then)
        is_done = asyncio.run(running)
    if not is_done:
        return None
    if not keeps_datasets:
        shutil.rmtree(data / "datasets", ignore_errors=True)
    parts = run_folder(folder) / "parts"
    names = [step["name"] for step in steps if step["kind"] == "evaluate"]
    return {name: _trials(parts / name / "checkpoints" / "rounds.jsonl") for name in names}


def run_once(
    steps: Sequence[Step],
    made_by: Mapping[str, Any],
    folder: Path,
    on_progress: Callable[[], None],
    *,
    source: Path | None = None,
) -> Path | None:
    """Runs a pipeline once for all arms that need what it makes; others wait. Its datasets are kept.

    Args:
        steps: Its steps.
        made_by: What it depends on besides.
        folder: Where the folders of such pipelines are.
        on_progress: Called now and then.
        source: See `run_pipeline`.

    Returns:
        The pipeline's folder; None when SIGTERM stopped it.

    Raises:
        FailedPrecondition: A step failed.
    """
    made = cache_path(folder, {**made_by, "steps": list(steps)})
    done = made / "done"
    with locked(made / "lock"):
        if not done.exists():
            if run_pipeline(steps, made, on_progress, source=source, keeps_datasets=True) is None:
                return None
            done.touch()
    return made


def run_folder(folder: Path) -> Path:
    """Returns the folder of the run of a pipeline in the folder of its arm."""
    return folder / "data" / "runs" / id_of(_NAME)


async def _run_to_its_end(
    services: Mapping[str, str],
    config: dict[str, Any],
    data: Path,
    on_progress: Callable[[], None],
    is_stopped: Callable[[], bool],
    *,
    then: Callable[[Mapping[str, str]], Awaitable[None]] | None,
) -> bool:
    """Returns whether the run came to its end: False when it was stopped before."""
    environ, ports = isolated_environ(os.environ), free_ports(_SERVICES)
    async with Stack(services, data_dir=data, environ=environ, ports=ports) as stack:
        await stack.ready(timeout_s=_READY_TIMEOUT_S)
        async with OrchestratorClient(channel_to(stack.addresses["orchestrator"], CliSettings())) as client:
            following = asyncio.create_task(_follow(client, config, on_progress))
            while not (following.done() or is_stopped()):
                await asyncio.wait([following], timeout=_POLL_S)
            if not following.done():
                following.cancel()
                await asyncio.wait([following])
                return False
            following.result()
        if then:
            await then(stack.addresses)
        return True


async def _follow(client: OrchestratorClient, config: dict[str, Any], on_progress: Callable[[], None]) -> None:
    """Starts the run, or finds it, and follows it to its end."""
    run = (await client.start_run(StartRunRequest("pipeline", config, idempotency_key=_NAME))).run
    async with aclosing(follow_run(client, run.id)) as changes:
        async for changed in changes:
            run = changed
            on_progress()
    check_succeeded("pipeline", run)


def _trials(path: Path) -> list[dict[str, Any]]:
    """Returns the values of an evaluation's trials, a line per round."""
    return [trial for line in path.read_bytes().splitlines() for trial in json.loads(line)["trials"]]


def _link_folder(source: Path, target: Path) -> None:
    """Copies a folder, if it is there, as hard links, once; a copy that was cut short is made again."""
    if source.is_dir() and not target.exists():
        part = target.with_name(f".{target.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(source, part, copy_function=os.link)
        part.rename(target)
