"""Zero-shot execution, section 2.4: policies cloned from labelled segments execute longer recipes than were shown.

Everything but the true labels of the ceiling is a pipeline of the orchestrator, so that what is measured is what a user
would get. All arms learn from the same demonstrations, which are collected once:

    <work>/demonstrations/<hash>/data/   the services' data directory with their dataset
"""

import shutil
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from experiments.segmentation import trials
from experiments.segmentation.evaluation import LEAST_SEGMENT, SMOOTHING
from experiments.segmentation.study import Study
from experiments.workbench.arms import Arm, Experiment, world_version
from experiments.workbench.cache_paths import cache_path
from experiments.workbench.configs import Config
from experiments.workbench.locks import locked
from experiments.workbench.pipelines import Step, Trials, fit_step, run_pipeline, step
from experiments.workbench.results import Outcome, Sample
from freerein.data import Dataset, dataset_path
from freerein.data.labels import LabelsInfo, LabelsWriter
from freerein.learning.checkpoints import JSON
from freerein.types.common import ModelRef
from freerein.types.sim import DemonstrateRequest
from freerein_sim.workers.demonstrations import make_demonstration
from freerein_sim.worlds.tasks import tasks

CLONED, EXPERT, TRUE_LABELS, RANDOM_LABELS = "cloned", "expert", "true", "random"
SUBTASKS, WHOLE_RECIPES = "zero_shot.subtasks", "zero_shot.whole"

_DATASET, _RECIPES, _COLLECTED = "demonstrations", "recipes", "collected"
_HELD_OUT_SEED = 1_000_003
_SLOWNESS = 2
"""Steps for a recipe relative to those of an episode: policies are slower than the expert."""

_ENVIRONMENTS = 25


@dataclass(frozen=True)
class Labelled:
    """Labels that policies are cloned from: those of a segmentation network, true ones, or random ones.

    Attributes:
        method: Method of the network; or `TRUE_LABELS` or `RANDOM_LABELS`.
        context: Context of the network; empty without one.
        earlier: Timesteps by which its labels are moved to the front.
        seeds: Number of times that network and policies are trained.
    """

    method: str
    context: str = ""
    earlier: int = 0
    seeds: int = 1

    @property
    def options(self) -> dict[str, str]:
        """Options of an arm."""
        earlier = f"earlier-{self.earlier}" if self.earlier else ""
        named = {"labels": self.method, "context": self.context, "moved": earlier}
        return {name: value for name, value in named.items() if value}


@dataclass(frozen=True)
class ZeroShot(Experiment):
    """Arms that clone skill policies from labels, and have them execute recipes; without a table.

    Attributes:
        source: Name of the segmentation experiment that has the methods and their learning rates.
        study: Its study of the world.
        labels: What is cloned.
        policies: Keys of the imitation service's configuration.
        recipes: Number of recipes that are executed; they are as long as those of the study's test split.
    """

    source: str
    study: Study
    labels: tuple[Labelled, ...]
    policies: Mapping[str, JSON]
    recipes: int

    @property
    def arms(self) -> tuple[Arm, ...]:
        """The scripted expert, then all policies of a seed before those of the next."""
        cloned = [
            Arm(self.study.world, CLONED, labels.options, seed)
            for seed in range(max(each.seeds for each in self.labels))
            for labels in self.labels
            if seed < labels.seeds
        ]
        return (Arm(self.study.world, EXPERT), *cloned)

    @property
    def sources(self) -> tuple[str, ...]:
        """The segmentation experiment, whose labels' accuracies are shown, too."""
        return (self.source,)

    def config(self, arm: Arm) -> Config:
        """Returns everything that an arm's result depends on, beside its name, the world, the code and the trials."""
        config: dict[str, object] = {"recipes": self.recipes, "data": self.study.data}
        if arm.method == CLONED:
            config["policies"] = dict(self.policies)
        if arm.method == CLONED and "context" in arm.options:
            config |= {"fit": self.study.fit_config(_network(arm)), "smoothing": SMOOTHING, **_earlier(arm)}
        return config

    def prepare(self, arm: Arm, work: Path) -> bool:
        """Collects the demonstrations that all policies are cloned from, or waits until another arm has."""
        if arm.method == EXPERT:
            return True
        folder = self._demonstrations(work)
        with locked(folder.with_suffix(".lock")):
            if not (folder / _COLLECTED).is_file():
                if run_pipeline([self._collect], folder, lambda: None, keeps_datasets=True) is None:
                    return False
                (folder / _COLLECTED).touch()
        return True

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Labels, clones and executes; see `Experiment`."""
        if arm.method == EXPERT:
            return _outcome(run_pipeline([self._executed("expert")], folder, on_progress))
        root = dataset_path(folder / "data", _DATASET)
        if not root.exists():
            copy = root.with_suffix(".copy")
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(dataset_path(self._demonstrations(work) / "data", _DATASET), copy)
            copy.replace(root)
        cloned = [
            fit_step("fit", "imitation", _DATASET, **{**self.policies, "seed": arm.seed}),
            self._executed({"model": "default"}),
        ]
        if "context" in arm.options:
            cloned = [*self._labelled(arm, results.parent / self.source), *cloned]
        elif arm.options["labels"] == TRUE_LABELS:
            _label_truly(self._request, root)
        else:
            _label_at_random(arm, root)
        return _outcome(run_pipeline(cloned, folder, on_progress))

    @property
    def _request(self) -> DemonstrateRequest:
        """The request of the demonstrations, with their true labels."""
        train = self.study.data.train
        return DemonstrateRequest(
            self.study.world,
            "expert",
            min_skills=train.least_skills,
            max_skills=train.most_skills,
            count=train.count,
            seed=self.study.data.seed,
            height=1,
            width=1,
            privileged=True,
        )

    @property
    def _collect(self) -> Step:
        asked = self._request
        return step(
            _DATASET,
            "collect",
            dataset=_DATASET,
            task=asked.task,
            behaviour=asked.behaviour,
            count=asked.count,
            min_skills=asked.min_skills,
            max_skills=asked.max_skills,
            seed=asked.seed,
        )

    def _demonstrations(self, work: Path) -> Path:
        made_by = {"collect": self._collect, "world_version": world_version(self.study.world)}
        return cache_path(work / "demonstrations", made_by)

    def _labelled(self, arm: Arm, results: Path) -> list[Step]:
        network = _network(arm)
        config = asdict(self.study.fit_config(network)) | {"lr": trials.chosen_lr(network, results)}
        return [
            fit_step("fit-labels", "segmentation", _DATASET, **config),
            step("labels", "label", dataset=_DATASET, smoothing=SMOOTHING, min_kept=LEAST_SEGMENT, **_earlier(arm)),
        ]

    def _executed(self, policy: JSON) -> Step:
        return step(
            _RECIPES,
            "evaluate",
            form="recipes",
            task=self.study.world,
            policy=policy,
            skills_per_recipe=self.study.data.test.most_skills,
            step_limits="own",
            episode_steps=_SLOWNESS * self.study.data.world.max_episode_steps,
            episodes=self.recipes,
            num_envs=_ENVIRONMENTS,
            seed=_HELD_OUT_SEED,
        )


def _network(arm: Arm) -> Arm:
    """Returns the arm of the network that labels."""
    return Arm(arm.world, arm.options["labels"], {"context": arm.options["context"]}, arm.seed)


def _earlier(arm: Arm) -> dict[str, int]:
    moved = arm.options.get("moved")
    return {"earlier": int(moved.removeprefix("earlier-"))} if moved else {}


def _label_at_random(arm: Arm, root: Path) -> None:
    """Labels equal parts of each demonstration by its skills in a random order, where predicted labels lie."""
    skills, rng, dataset = tasks()[arm.world].spec.skills, np.random.default_rng(arm.seed), Dataset(root)
    with LabelsWriter(root, name=RANDOM_LABELS) as writer:
        for index, length in enumerate(dataset.lengths):
            order = rng.permutation([skills.index(each) for each in dataset.skills[index]])
            writer.save(index, order[np.arange(length) * len(order) // length])
        writer.finish(LabelsInfo(skills, ModelRef(RANDOM_LABELS, "")))


def _label_truly(request: DemonstrateRequest, root: Path) -> None:
    """Labels demonstrations truly, by making them again, where predicted labels lie."""
    task = tasks()[request.task]
    lengths = Dataset(root).lengths
    with closing(task.make()) as world, LabelsWriter(root, name="truth") as writer:
        for index, length in enumerate(lengths):
            made = make_demonstration(task, world, replace(request, first=index))
            if len(made.labels) != length:
                raise AssertionError(f"Demonstration {index} must have {length} timesteps when it is made again.")
            writer.save(index, made.labels)
        writer.finish(LabelsInfo(task.spec.skills, ModelRef("truth", "")))


def _outcome(found: Trials | None) -> Outcome | None:
    if found is None:
        return None
    completed = [np.array(each["completed"], np.bool_) for each in found[_RECIPES]]
    subtasks = Sample.of_flags(completed)
    whole = Sample.of_flags(np.array([each.all()]) for each in completed)
    return Outcome({SUBTASKS: subtasks.mean, WHOLE_RECIPES: whole.mean}, {SUBTASKS: subtasks, WHOLE_RECIPES: whole})
