"""The stages of the demo: start the services, record, fit, measure, draw."""

import os
import time
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager, nullcontext
from pathlib import Path

from freerein.cli.demo import (
    imitation,
    language_policies,
    output_folder,
    pictures,
    report,
    reward,
    segmentation,
    skill_policies,
)
from freerein.cli.demo.context import Context
from freerein.cli.demo.report import Figure, Reporter
from freerein.cli.demo.reward import Scenes
from freerein.cli.demo.segmentation import BLOCKS, GRID
from freerein.cli.services import Endpoints, Stack, choose, free_ports
from freerein.cli.services.endpoints import is_free, running_endpoints
from freerein.cli.settings import CliSettings
from freerein.ports import PORTS, Ports

_SERVICES = ("sim", "segmentation", "imitation", "reward", "orchestrator")
_READY_TIMEOUT_S = 60.0
_LONGEST_S = 600.0
_SHIPPED = {"ppo": [language_policies.INIT_FROM], "distill": list(language_policies.SHIPPED_TEACHERS)}


async def run(out: Path, *, seed: int, reporter: Reporter, running: bool) -> None:
    """Runs every stage, and writes `summary.json`, `summary.md` and the pictures into `out`, which is emptied first.

    With `running`, services that already run are used, where the environment says; else the demo starts its own. Raises
    ServiceError where the folder is not the demo's to empty, or a stage failed.
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
        measured = await _learn_and_measure(Context(endpoints, settings, data_dir, seed, reporter), out)
    figures = (*measured, Figure("total_s", time.perf_counter() - started_s, at_most=_LONGEST_S))
    summary = report.summary(figures, seed=seed, shipped=_SHIPPED)
    report.write(out, figures, summary)
    reporter.summary(figures, summary)
    for stage, models in _SHIPPED.items():
        reporter.line(f"{stage} used policies that came with freerein: {', '.join(models)}")
    reporter.line(f"Figures: {out}/summary.json and {out}/summary.md. Pictures: {out}/*.png.")
    if not running:
        reporter.line(f"Serve these models: FREEREIN_DATA_DIR={data_dir} freerein up. The next demo deletes them.")


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


async def _learn_and_measure(context: Context, out: Path) -> tuple[Figure, ...]:
    """Runs every stage, and draws the pictures; returns what was measured."""
    stage = context.reporter.stage
    with stage("Record demonstrations, exploration and images"):
        for task in (GRID, BLOCKS):
            await segmentation.record(context, task)
        await imitation.record(context)
        await reward.record(context)
    started_s = time.perf_counter()
    with stage("Fit segmentation models; in parallel a reward model and a goal-conditioned policy"):
        fits = [await segmentation.start_fit(context, task) for task in (GRID, BLOCKS)]
        others = [await reward.start_fit(context), await imitation.start_fit(context)]
        for fit in fits:
            await context.follow_fit(fit)
    with stage("Label held-out trajectories, and the demonstrations for skill policies"):
        grid, blocks = [await segmentation.label_held_out(context, task) for task in (GRID, BLOCKS)]
        await skill_policies.label_demonstrations(context)
        others.append(await skill_policies.start_fit(context))
    with stage("Finish the other fits"):
        for fit in others:
            await context.follow_fit(fit)
    fits_s = time.perf_counter() - started_s
    baselines_run = await language_policies.start_baselines(context)
    with stage("Evaluate goal images, rewards and recipes"):
        goal_images = await imitation.follow_goal_images(context)
        two, four = await reward.look_at_two_blocks(context), Scenes.of_rollout(goal_images.exploration)
        two_blocks = await reward.classify(context, "two_blocks", two)
        four_blocks = await reward.classify(context, "four_blocks", four)
        examples = await reward.examples(context, two, four)
        recipes = await skill_policies.execute_recipes(context)
    with stage("Train a policy by PPO on images and the learned reward"):
        baselines = await language_policies.finish_baselines(context, baselines_run)
        ppo = await language_policies.learn_by_ppo(context)
    with stage("Distill it and a shipped policy into one that is told in words what to do"):
        student = await language_policies.distill(context, ppo.run)
    with stage("Draw"):
        for task, labelled in ((GRID, grid), (BLOCKS, blocks)):
            path = out / f"timeline-{task.task}.png"
            pictures.draw_timeline(path, segmentation.median(labelled), task=task.task)
        pictures.draw_rewards(out / "rewards.png", examples)
        pictures.draw_filmstrip(out / "filmstrip.png", goal_images.filmstrip)
        pictures.draw_returns(out / "ppo.png", ppo.curve, language_policies.returns_by_panel(baselines, ppo, student))
    return (
        *segmentation.figures(blocks, grid),
        *two_blocks,
        *four_blocks,
        *goal_images.figures,
        *recipes,
        *language_policies.figures(baselines, ppo, student),
        Figure("fits_s", fits_s),
    )


def _ports() -> dict[str, Ports]:
    """Returns the standard ports, or free ports when one of them is taken."""
    taken = [port for name in _SERVICES for port in (PORTS[name].rest, PORTS[name].grpc) if not is_free(port)]
    return free_ports(_SERVICES) if taken else {name: PORTS[name] for name in _SERVICES}
