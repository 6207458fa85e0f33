"""The demo: starts the services, runs the pipeline, draws the pictures, writes the table."""

import json
import os
import time
from collections.abc import AsyncGenerator, Mapping
from contextlib import aclosing, asynccontextmanager, nullcontext
from pathlib import Path

from freerein.cli.connection import channel_to
from freerein.cli.demo import output_folder, pictures, report
from freerein.cli.demo.figures import figures
from freerein.cli.demo.pipeline import SHIPPED_TEACHERS, SIDES, pipeline
from freerein.cli.demo.report import Measured, Reporter
from freerein.cli.demo.results import Results, fetch, filmstrip, labelled_trajectory, reward_examples
from freerein.cli.jobs.display import check_succeeded
from freerein.cli.jobs.streams import follow_run
from freerein.cli.services import Endpoints, Stack, choose, free_ports
from freerein.cli.services.endpoints import is_free, running_endpoints
from freerein.cli.settings import CliSettings
from freerein.clients import OrchestratorClient, RewardClient
from freerein.ports import PORTS, Ports
from freerein.types.orchestrator import GetMetricsRequest, StartRunRequest

_SERVICES = ("sim", "segmentation", "imitation", "reward", "orchestrator")
_READY_TIMEOUT_S = 300.0
_SHIPPED = {"distill": list(SHIPPED_TEACHERS)}
_CURVE = "ppo/episode_return"
_MAX_ROWS = 10_000


async def run(out: Path, *, seed: int, reporter: Reporter, running: bool) -> None:
    """Runs the pipeline, and writes `summary.json`, `summary.md` and the pictures into `out`, which is emptied first.

    With `running`, services that already run are used, where the environment says; else the demo starts its own. Raises
    ServiceError where the folder is not the demo's to empty, or a step failed.
    """
    started_s = time.perf_counter()
    settings = CliSettings()
    data_dir = settings.data_dir if running else out / "data"
    is_own = not running and data_dir.resolve() == settings.data_dir.resolve()
    output_folder.prepare(out, keep=None if is_own else settings.data_dir)
    stack = nullcontext(running_endpoints(_SERVICES, os.environ)) if running else _start(data_dir, reporter)
    async with stack as endpoints:
        for name, url in endpoints.urls.items():
            reporter.line(f"{name:<13} {url}/docs   gRPC {endpoints.addresses[name]}")
        channels = {name: channel_to(address, settings) for name, address in endpoints.addresses.items()}
        async with OrchestratorClient(channels["orchestrator"]) as orchestrator:
            with reporter.stage("Record, fit, label, evaluate, train by PPO, distill"):
                results, curve = await _run_pipeline(orchestrator, out, seed=seed, reporter=reporter)
        async with RewardClient(channels["reward"]) as reward:
            with reporter.stage("Draw"):
                await _draw(out, results, curve, reward)
    measured = figures(results, total_s=time.perf_counter() - started_s)
    summary = report.summary(measured, seed=seed, shipped=_SHIPPED)
    report.write(out, measured, summary)
    reporter.summary(measured, summary)
    for stage, models in _SHIPPED.items():
        reporter.line(f"{stage} used policies that came with freerein: {', '.join(models)}")
    reporter.line(f"Figures: {out}/summary.json and {out}/summary.md. Pictures: {out}/*.png.")
    if not running:
        reporter.line(f"Serve these models: FREEREIN_DATA_DIR={data_dir} freerein up. The next demo deletes them.")


async def _run_pipeline(
    client: OrchestratorClient, out: Path, *, seed: int, reporter: Reporter
) -> tuple[Results, list[tuple[int, float]]]:
    """Runs the pipeline to its end; returns its artifacts, and the learned return by iteration of PPO."""
    config = pipeline(seed)
    path = out / "pipeline.json"
    path.write_text(json.dumps(config, indent=2) + "\n")
    reporter.command(f"freerein runs start pipeline --config {path}")
    run_id = (await client.start_run(StartRunRequest("pipeline", config))).run.id
    reporter.command(f"freerein runs watch {run_id}")
    with reporter.steps([step["name"] for step in config["steps"]]) as show:
        async with aclosing(follow_run(client, run_id)) as changes:
            async for run in changes:
                show(run)
    check_succeeded("pipeline", run)
    rows = (await client.get_metrics(GetMetricsRequest(run_id, max_rows=_MAX_ROWS))).rows
    iterations = [row for row in rows if any(name.startswith("ppo/") for name in row.metrics)]
    first = iterations[0].step
    curve = [(row.step - first + 1, row.metrics[_CURVE]) for row in iterations if _CURVE in row.metrics]
    return await fetch(client, run_id), curve


async def _draw(out: Path, results: Results, curve: list[tuple[int, float]], reward: RewardClient) -> None:
    for task in ("grid", "blocks"):
        labelled = labelled_trajectory(results, f"{task}-labels")
        pictures.timeline_figure(labelled, task=task).savefig(out / f"timeline-{task}.png")
    pictures.rewards_figure(await reward_examples(results, reward)).savefig(out / "rewards.png")
    pictures.filmstrip_figure(filmstrip(results)).savefig(out / "filmstrip.png")
    pictures.returns_figure(curve, _returns_by_panel(results)).savefig(out / "ppo.png")


def _returns_by_panel(results: Results) -> dict[str, Mapping[str, Measured]]:
    """Returns what the picture compares: mean returns by policy, by the title of their panel."""
    told, random = results.told(), {side: results.figure(f"random-{side}", "return_mean") for side in SIDES}
    student = {
        side: {f'student,\ntold "{each}"': told[side, each] for each in sorted(SIDES, key=side.__ne__)}
        for side in SIDES
    }
    ppo = {
        "untrained": results.figure("ppo-returns", "baseline_return_mean"),
        "ppo": results.figure("ppo-returns", "return_mean"),
        "expert": results.figure("ppo-returns", "expert_return_mean"),
    }
    return {
        "left-of: steps at the goal": {"random": random["left"], **ppo, **student["left"]},
        "right-of: steps at the goal": {"random": random["right"], **student["right"]},
    }


def isolated_environ(environ: Mapping[str, str]) -> dict[str, str]:
    """Returns an environment without what would connect the demo's own services to other people's."""
    shared = {"FREEREIN_DATABASE_URL", "FREEREIN_EXECUTOR_ID", *(f"FREEREIN_{name.upper()}_ADDRESS" for name in PORTS)}
    return {name: value for name, value in environ.items() if name not in shared}


@asynccontextmanager
async def _start(data_dir: Path, reporter: Reporter) -> AsyncGenerator[Endpoints, None]:
    """Runs the demo's own services within the block."""
    environ = isolated_environ(os.environ)
    async with Stack(choose(_SERVICES), data_dir=data_dir, environ=environ, ports=_ports()) as stack:
        with reporter.stage("Start the services"):
            reporter.command("freerein up")
            await stack.ready(timeout_s=_READY_TIMEOUT_S)
        yield Endpoints(stack.urls, stack.addresses)


def _ports() -> dict[str, Ports]:
    """Returns the standard ports, or free ports when one of them is taken."""
    taken = [port for name in _SERVICES for port in (PORTS[name].rest, PORTS[name].grpc) if not is_free(port)]
    return free_ports(_SERVICES) if taken else {name: PORTS[name] for name in _SERVICES}
