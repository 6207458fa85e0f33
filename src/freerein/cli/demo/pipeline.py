"""The demo's stages: start the services, record, fit side by side, measure what came of it, draw."""

import os
import time
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from freerein.cli import services
from freerein.cli.demo import (
    distilling,
    figures,
    filmstrip,
    folder,
    heatmaps,
    imitating,
    learning_curve,
    reinforcing,
    rewarding,
    skilling,
    timeline,
)
from freerein.cli.demo.context import Context
from freerein.cli.demo.distilling import Distilled
from freerein.cli.demo.evaluating import Earned
from freerein.cli.demo.figures import Figure
from freerein.cli.demo.fits import follow_fit
from freerein.cli.demo.heatmaps import Judged
from freerein.cli.demo.imitating import Following
from freerein.cli.demo.reinforcing import Baselines, Reinforced
from freerein.cli.demo.rewarding import Judgements
from freerein.cli.demo.screen import Screen
from freerein.cli.demo.segmenting import BLOCKS, GRID, Labels, label_held_out, record_lesson, start_lesson
from freerein.cli.demo.skilling import Executed
from freerein.cli.services import Doors, choose, free_ports, is_free
from freerein.cli.settings import CliSettings
from freerein.cli.supervisor import Stack
from freerein.ports import PORTS, Ports

_SERVICES = ("sim", "segmentation", "imitation", "reward", "orchestrator")
_READY_S = 60.0
_LONGEST_S = 600.0


@dataclass(frozen=True, eq=False)
class _Results:
    """What came of the demo."""

    labels: dict[str, Labels]
    judgements: Judgements
    judged: tuple[Judged, ...]
    following: Following
    executed: Executed
    before: Baselines
    reinforced: Reinforced
    distilled: Distilled
    training_s: float


async def run(out: Path, *, seed: int, screen: Screen, running: bool) -> None:
    """Runs every stage, and writes `summary.json` and the pictures.

    Args:
        out: The folder for all of it: new, empty, or an earlier demo's, which is emptied.
        seed: Seed of every draw.
        screen: What a person sees.
        running: Whether services run already, where the environment says; else it starts its own.

    Raises:
        ServiceError: The folder is none of these, or a stage did not finish.
    """
    begun = time.perf_counter()
    settings = CliSettings()
    data_dir = settings.data_dir if running else out / "data"
    is_own = not running and data_dir.resolve() == settings.data_dir.resolve()
    folder.begin(out, keep=None if is_own else settings.data_dir)
    started = nullcontext(services.running(_SERVICES, os.environ)) if running else _start(data_dir, screen)
    async with started as doors:
        for name, url in doors.urls.items():
            screen.say(f"{name:<13} {url}/docs   gRPC {doors.addresses[name]}")
        results = await _learn_and_measure(Context(doors, settings, data_dir, out, seed, screen))
    with screen.stage("Draw"):
        for path, caption in _draw(results, out):
            screen.say(f"{path}: {caption}")
    measured = _figures(results, total_s=time.perf_counter() - begun)
    begun_with = _begun_with()
    summary = figures.document(measured, seed=seed, begun_with=begun_with)
    figures.save(out / "summary.json", summary)
    screen.summary(measured, summary, begun_with=begun_with)
    screen.say(f"{out / 'summary.json'} holds these figures.")
    if not running:
        screen.say(
            f"To go on with these models: FREEREIN_DATA_DIR={data_dir} freerein up. The next demo empties that folder."
        )


def environ_of_its_own(environ: Mapping[str, str]) -> dict[str, str]:
    """Returns an environment for services of the demo's own: without what would have them work with somebody else's."""
    shared = {"FREEREIN_DATABASE_URL", "FREEREIN_EXECUTOR_ID", *(f"FREEREIN_{name.upper()}_ADDRESS" for name in PORTS)}
    return {name: value for name, value in environ.items() if name not in shared}


@asynccontextmanager
async def _start(data_dir: Path, screen: Screen) -> AsyncGenerator[Doors, None]:
    """Runs services of our own for as long as the block does."""
    environ = environ_of_its_own(os.environ)
    async with Stack(choose(_SERVICES), data_dir=data_dir, environ=environ, ports=_ports()) as stack:
        with screen.stage("Start the services"):
            screen.call("freerein up")
            await stack.ready(timeout_s=_READY_S)
        yield Doors(stack.urls, stack.addresses)


async def _learn_and_measure(context: Context) -> _Results:
    screen = context.screen
    with screen.stage("Record demonstrations, exploration, and scattered blocks"):
        for lesson in (GRID, BLOCKS):
            await record_lesson(context, lesson)
        await imitating.record_exploration(context)
        await rewarding.record_scatter(context)
    begun = time.perf_counter()
    with screen.stage("Learn skills from tags; a reward from noun phrases, and a policy from exploration, beside"):
        lessons = {lesson.task: await start_lesson(context, lesson) for lesson in (GRID, BLOCKS)}
        others = [await rewarding.start_reward(context), await imitating.start_following(context)]
        for fit in lessons.values():
            await follow_fit(context, fit)
    with screen.stage("Label what was held out, and what skill policies are to be learned from"):
        labels = {lesson.task: await label_held_out(context, lesson) for lesson in (GRID, BLOCKS)}
        await skilling.label_demonstrations(context)
        others.append(await skilling.start_skills(context))
    with screen.stage("Learn the rest"):
        for fit in others:
            await follow_fit(context, fit)
    training_s = time.perf_counter() - begun
    baselines = await reinforcing.start_baselines(context, distilling.TASKS)
    with screen.stage("Ask for rewards, follow goal images, execute recipes"):
        judgements, judged = await rewarding.judge_held_out(context)
        followed = await imitating.follow(context)
        executed = await skilling.execute(context)
    with screen.stage("Learn by PPO what a sentence asks for, from images and the reward that was learned"):
        before = await reinforcing.finish_baselines(context, baselines, distilling.TASKS)
        reinforced = await reinforcing.reinforce(context)
    with screen.stage("Distill that, and a policy that came with freerein, into one that is told in words what to do"):
        distilled = await distilling.distill(context, reinforced.run)
    return _Results(labels, judgements, judged, followed, executed, before, reinforced, distilled, training_s)


def _draw(results: _Results, out: Path) -> list[tuple[Path, str]]:
    """Writes the pictures; returns where they are, and what they show."""
    drawn = []
    for task, labels in results.labels.items():
        path = out / f"timeline-{task}.png"
        timeline.draw(path, labels.median, title=f"Who does what when: a held-out trajectory of {task}")
        drawn.append((path, "the trajectory of median accuracy"))
    heatmaps.draw(
        out / "rewards.png",
        results.judged,
        title="Where the things are, and which words fit best",
        subtitle="held-out images; the reward of a text is 1 where its bar is the longest; "
        "learned from unlabelled images and noun phrases",
    )
    drawn.append((out / "rewards.png", "what the reward model sees in held-out images"))
    filmstrip.draw(
        out / "filmstrip.png",
        results.following.pursued,
        title="Following goal images never seen",
        subtitle="what the robot saw when it went on to the next goal, and how sure it was; green where it truly was "
        "there; learned from random exploration",
    )
    drawn.append((out / "filmstrip.png", "the robot of median success"))
    learning_curve.draw(
        out / "ppo.png",
        results.reinforced.curve,
        {
            "random": results.before.random[reinforcing.TASK],
            "before": results.before.first,
            "after": results.reinforced.last,
            "distilled": results.distilled.earned[reinforcing.TASK],
        },
        title=f"Learned from a sentence and pixels: {reinforcing.TASK.partition('.')[2].replace('-', ' ')}",
        subtitle="PPO on the learned reward; measured in 50 episodes each, against true states that it never sees; "
        "lines are 95 % intervals, green is above chance",
    )
    drawn.append((out / "ppo.png", "what PPO learned from words and pixels"))
    return drawn


def _figures(results: _Results, *, total_s: float) -> tuple[Figure, ...]:
    blocks, grid, following = results.labels["blocks"], results.labels["grid"], results.following
    chance = blocks.random_cls_accuracy
    return (
        Figure("segmentation.frame_accuracy", blocks.frame_accuracy, at_least=chance + 0.25),
        Figure("segmentation.random_cls_accuracy", chance),
        Figure("grid.frame_accuracy", grid.frame_accuracy, at_least=0.99),
        Figure("grid.random_cls_accuracy", grid.random_cls_accuracy),
        Figure("reward.accuracy", results.judgements.accuracy, at_least=0.85),
        Figure("reward.balanced_accuracy", results.judgements.balanced_accuracy),
        Figure(
            "imitation.landmarks_reached",
            following.landmarks_reached,
            at_least=max(0.5, 2 * following.random_landmarks_reached),
        ),
        Figure("imitation.landmarks_recognized", following.landmarks_recognized),
        Figure("imitation.random_landmarks_reached", following.random_landmarks_reached),
        Figure("imitation.goal_auroc", following.goal_auroc, at_least=0.9),
        Figure("recipe.skills_completed", results.executed.skills_completed, above=results.executed.random_completed),
        Figure("recipe.random_skills_completed", results.executed.random_completed),
        *_figures_of_words(results.before, results.reinforced, results.distilled),
        Figure("training_s", results.training_s),
        Figure("total_s", total_s, at_most=_LONGEST_S),
    )


def _figures_of_words(before: Baselines, reinforced: Reinforced, distilled: Distilled) -> tuple[Figure, ...]:
    first, last = before.first, reinforced.last
    chance = _mean(before.random)
    return (
        Figure("ppo.return_first", first.mean),
        Figure("ppo.return_first_high", first.high),
        Figure("ppo.return_begun", before.begun.mean),
        Figure("ppo.return_last", last.mean),
        Figure("ppo.return_last_low", last.low, above=first.high),
        Figure("ppo.random_return", before.random[reinforcing.TASK].mean),
        Figure("ppo.training_s", reinforced.training_s),
        Figure("distill.return", _mean(distilled.earned), above=chance),
        Figure("distill.random_return", chance),
        Figure("distill.training_s", distilled.training_s),
    )


def _mean(earned: Mapping[str, Earned]) -> float:
    """Returns what is earned per episode, over all tasks."""
    return sum(each.mean for each in earned.values()) / len(earned)


def _begun_with() -> dict[str, list[str]]:
    """Returns the policies that were begun with and not learned here, by stage."""
    return {"ppo": [reinforcing.STARTS_FROM], "distill": list(distilling.SHIPPED_TEACHERS.values())}


def _ports() -> dict[str, Ports]:
    """Returns the port table, or free ports when somebody listens there already."""
    taken = [port for name in _SERVICES for port in (PORTS[name].rest, PORTS[name].grpc) if not is_free(port)]
    return free_ports(_SERVICES) if taken else {name: PORTS[name] for name in _SERVICES}
