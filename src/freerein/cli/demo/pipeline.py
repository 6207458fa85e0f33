"""The demo's stages: start the services, record demonstrations, fit, label what was held out, measure, draw."""

import os
import shutil
import time
from collections.abc import Mapping
from contextlib import aclosing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from freerein.cli.demo import figures, timeline
from freerein.cli.demo.door import Door
from freerein.cli.demo.figures import Figure
from freerein.cli.demo.screen import Screen
from freerein.cli.demo.timeline import Labelled
from freerein.cli.recording import record
from freerein.cli.services import choose, free_ports, is_free
from freerein.cli.supervisor import Stack
from freerein.clients import Channel, SimClient
from freerein.data import Dataset, dataset_path, truth
from freerein.errors import FailedPrecondition
from freerein.metrics import random_cls_accuracy
from freerein.ports import PORTS, Ports
from freerein.types.sim import DemonstrateRequest

_SERVICES = ("sim", "segmentation")
_READY_S = 60.0
_HELD_OUT = 1_000_000  # added to the seed: no held-out trajectory was trained on


@dataclass(frozen=True)
class Recipe:
    """What the demo does in one world.

    Attributes:
        task: The task that is demonstrated.
        train: Trajectories to learn from, tagged with the set of their skills.
        train_skills: Fewest and most different skills in each of them.
        held_out: Trajectories to label.
        held_out_skills: Different skills in each of these: more than in any that was learned from.
        config: The fit's configuration, where it is not the default.
    """

    task: str
    train: int
    train_skills: tuple[int, int]
    held_out: int
    held_out_skills: int
    config: Mapping[str, object]


GRID = Recipe("grid", 1000, (2, 4), 100, 5, {"steps": 300, "batch_size": 16})
BLOCKS = Recipe("blocks", 400, (2, 3), 60, 4, {"stride": 3})


@dataclass(frozen=True, eq=False)
class _Result:
    """What came of a recipe."""

    labelled: tuple[Labelled, ...]
    training_s: float

    @property
    def frame_accuracy(self) -> float:
        return _over_all_timesteps([(each.accuracy, len(each.truth)) for each in self.labelled])

    @property
    def random_cls_accuracy(self) -> float:
        return _over_all_timesteps([(random_cls_accuracy(each.truth), len(each.truth)) for each in self.labelled])

    @property
    def median(self) -> Labelled:
        """The trajectory labelled neither best nor worst: the one that is drawn."""
        return sorted(self.labelled, key=lambda each: each.accuracy)[len(self.labelled) // 2]


async def run(out: Path, *, seed: int, screen: Screen) -> None:
    """Runs every stage, and writes `summary.json` and the pictures.

    Args:
        out: The folder for all of it; emptied first.
        seed: Seed of every draw.
        screen: What a person sees.

    Raises:
        ServiceError: A stage did not finish.
    """
    begun = time.perf_counter()
    _empty(out)
    stack = Stack(choose(_SERVICES), data_dir=out / "data", environ=os.environ, ports=_ports())
    async with stack:
        with screen.stage("Start the services"):
            screen.call("freerein up")
            await stack.ready(timeout_s=_READY_S)
            for name, url in stack.urls.items():
                screen.say(f"{name:<13} {url}/docs   gRPC {stack.addresses[name]}")
        results = {}
        for recipe in (GRID, BLOCKS):
            await _record(recipe, stack, out / "data", seed=seed, screen=screen)
            results[recipe.task] = await _learn(recipe, stack, out, seed=seed, screen=screen)
    with screen.stage("Draw"):
        for task, result in results.items():
            path = out / f"timeline-{task}.png"
            timeline.draw(path, result.median, title=f"Who does what when: a held-out trajectory of {task}")
            screen.say(f"{path}: the trajectory of median accuracy")
    measured = _figures(results["blocks"], results["grid"], total_s=time.perf_counter() - begun)
    summary = figures.document(measured, seed=seed)
    figures.save(out / "summary.json", summary)
    screen.summary(measured, summary)
    screen.say(f"{out / 'summary.json'} holds these figures.")
    screen.say(f"To go on with these models: FREEREIN_DATA_DIR={out / 'data'} freerein up")


async def _record(recipe: Recipe, stack: Stack, data_dir: Path, *, seed: int, screen: Screen) -> None:
    """Records what is learned from, tags only, and what is held out, with labels to measure by."""
    fewest, most = recipe.train_skills
    more = recipe.held_out_skills
    train = DemonstrateRequest(recipe.task, "expert", min_skills=fewest, max_skills=most, count=recipe.train, seed=seed)
    held_out = DemonstrateRequest(
        recipe.task,
        "expert",
        min_skills=more,
        max_skills=more,
        count=recipe.held_out,
        seed=seed + _HELD_OUT,
        privileged=True,
    )
    with screen.stage(f"Record demonstrations of {recipe.task}"):
        async with SimClient(Channel(stack.addresses["sim"])) as client:
            for name, request in ((_train_name(recipe), train), (_held_out_name(recipe), held_out)):
                screen.call(_command(name, request))
                with screen.progress(name, request.count) as advance:
                    await record(client, request, dataset_path(data_dir, name), on_count=advance)


def _command(name: str, request: DemonstrateRequest) -> str:
    """Returns what one would type to record the same."""
    return (
        f"freerein sim demonstrate {request.task} --out {name} --count {request.count} --seed {request.seed} "
        f"--min-skills {request.min_skills} --max-skills {request.max_skills}" + " --truth" * request.privileged
    )


async def _learn(recipe: Recipe, stack: Stack, out: Path, *, seed: int, screen: Screen) -> _Result:
    with screen.stage(f"Learn the skills of {recipe.task} from tags, and label what was held out"):
        async with Door(stack.urls["segmentation"], requests=out / "requests", screen=screen) as door:
            training_s = await _fit(recipe, door, seed=seed, screen=screen)
            return _Result(await _label(recipe, door, out / "data", screen=screen), training_s)


async def _fit(recipe: Recipe, door: Door, *, seed: int, screen: Screen) -> float:
    """Fits a model named like the task; returns how long that took, in seconds."""
    begun = time.perf_counter()
    request = {"dataset": _train_name(recipe), "model_name": recipe.task, "config": {**recipe.config, "seed": seed}}
    fit = (await door.post("/v1/start-fit", request))["fit"]
    with screen.progress("fit", fit["steps"]) as advance:
        async with aclosing(door.events("/v1/watch-fit", id=fit["id"])) as events:
            async for event in events:
                fit = event["fit"]
                advance(fit["step"], " ".join(f"{name} {value:.3g}" for name, value in fit["metrics"].items()))
    if fit["state"] != "succeeded":
        raise FailedPrecondition(
            f"The fit must succeed; it {fit['state']}. {fit['error']}",
            hint="Read log.txt in the fit's folder below the data directory.",
        )
    return time.perf_counter() - begun


async def _label(recipe: Recipe, door: Door, data_dir: Path, *, screen: Screen) -> tuple[Labelled, ...]:
    root = dataset_path(data_dir, _held_out_name(recipe))
    dataset = Dataset(root)
    labelled = []
    with screen.progress("label", len(dataset)) as advance:
        for index, trajectory in enumerate(dataset):
            (frames,) = trajectory.frames.values()
            answer = await door.segment(recipe.task, frames, trajectory.actions)
            labels = np.array(answer["labels"], np.int64)
            confidence = np.array(answer["confidence"], np.float32)
            spoken = Labelled(frames, truth.labels(root, index), labels, confidence, tuple(answer["skills"]))
            labelled.append(_in_vocabulary_of(dataset.spec.skills, spoken))
            advance(index + 1)
    return tuple(labelled)


def _in_vocabulary_of(skills: tuple[str, ...], labelled: Labelled) -> Labelled:
    """Returns labels as indices into the dataset's skills, which is what its truth holds."""
    index = np.array([skills.index(skill) for skill in labelled.skills], np.int64)
    return Labelled(labelled.frames, labelled.truth, index[labelled.labels], labelled.confidence, skills)


def _figures(blocks: _Result, grid: _Result, *, total_s: float) -> tuple[Figure, ...]:
    chance = blocks.random_cls_accuracy
    return (
        Figure("segmentation.frame_accuracy", blocks.frame_accuracy, at_least=chance + 0.25),
        Figure("segmentation.random_cls_accuracy", chance),
        Figure("grid.frame_accuracy", grid.frame_accuracy, at_least=0.99),
        Figure("grid.random_cls_accuracy", grid.random_cls_accuracy),
        Figure("training_s", blocks.training_s + grid.training_s),
        Figure("total_s", total_s, at_most=300.0),
    )


def _over_all_timesteps(parts: list[tuple[float, int]]) -> float:
    return sum(value * length for value, length in parts) / sum(length for _, length in parts)


def _empty(folder: Path) -> None:
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir(parents=True)


def _ports() -> dict[str, Ports]:
    """Returns the port table, or free ports when somebody listens there already."""
    taken = [port for name in _SERVICES for port in (PORTS[name].rest, PORTS[name].grpc) if not is_free(port)]
    return free_ports(_SERVICES) if taken else {name: PORTS[name] for name in _SERVICES}


def _train_name(recipe: Recipe) -> str:
    return f"{recipe.task}-train"


def _held_out_name(recipe: Recipe) -> str:
    return f"{recipe.task}-held-out"
