"""Table 4.2: one policy from many, told its task as a text, as the nearest training text's number, or not at all.

Students of the same 18 teachers, which ship. Three seeds each, 50 episodes a task, 36 tasks, two kinds of starts.
"""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.chapter4 import one_policy_report
from experiments.chapter4.shipped_teachers import shipped_teachers
from experiments.chapter4.students import (
    DATASET,
    DISSERTATION,
    IN_SCENES,
    OURS,
    RANDOM,
    SCENES,
    STUDENT,
    distil,
    evaluations,
    evaluations_in,
    figures,
    samples,
    samples_in_scenes,
)
from experiments.chapter4.unseen_colour import check_unseen, scanned
from experiments.workbench.arms import Arm, Experiment
from experiments.workbench.configs import Config
from experiments.workbench.pipelines import Step, Trials, link_folder, run_pipeline
from experiments.workbench.results import ArmResult, Outcome
from experiments.workbench.table import Table
from freerein.data import dataset_path

_WORLD, _SEEDS, _VERSION = "blocks", 3, 1
_ROWS = ((OURS, "text"), (OURS, "code"), (OURS, "none"), (DISSERTATION, "text"))
_TEXT = "conditioning"


class OnePolicy(Experiment):
    """An arm for each student, and one for random actions."""

    @property
    def arms(self) -> tuple[Arm, ...]:
        """Random actions, then all students of a seed, then ours in other scenes."""
        return (
            Arm(_WORLD, RANDOM),
            *(Arm(_WORLD, method, {_TEXT: how}, seed) for seed in range(_SEEDS) for method, how in _ROWS),
            *(Arm(_WORLD, IN_SCENES, {_TEXT: "text"}, seed) for seed in range(_SEEDS)),
        )

    def config(self, arm: Arm) -> Config:
        """Returns the teachers of a student, and the steps of the arm's pipeline; the scenes where it has some."""
        teachers = () if arm.method == RANDOM else shipped_teachers()
        scenes = {"scenes": list(SCENES)} if arm.method == IN_SCENES else {}
        return {"version": _VERSION, "teachers": list(teachers), "steps": list(_steps(arm)), **scenes}

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Distils a student, scans what it has learned from, and evaluates it on true states; see `Experiment`."""
        is_taught = arm.method != RANDOM
        trials = run_pipeline(_steps(arm), folder, on_progress, keeps_datasets=True)
        if trials is None:
            return None
        if is_taught:
            check_unseen(dataset_path(folder / "data", DATASET), folder)
        shutil.rmtree(folder / "data" / "datasets", ignore_errors=True)
        found = {f"scanned.{name}": value for name, value in scanned(folder).items()} if is_taught else {}
        if arm.method != IN_SCENES:
            return Outcome(dict(figures(trials)) | found, dict(samples(trials)))
        shown = _in_scenes(folder, on_progress)
        return None if shown is None else Outcome(found, dict(samples_in_scenes(shown)))

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the table of the arms that have results."""
        return one_policy_report.table(results)


def _steps(arm: Arm) -> list[Step]:
    return list(_random() if arm.method == RANDOM else _taught(arm))


def _random() -> Iterator[Step]:
    return evaluations(RANDOM)


def _taught(arm: Arm) -> Iterator[Step]:
    if arm.method == IN_SCENES:
        yield distil(OURS, arm.options[_TEXT], arm.seed)
    else:
        yield distil(arm.method, arm.options[_TEXT], arm.seed)
        yield from evaluations({"run": STUDENT})


def _in_scenes(folder: Path, on_progress: Callable[[], None]) -> Trials | None:
    """Evaluates the student of an arm in all scenes, each a pipeline of its own: one of all would be too long."""
    trials: dict[str, Sequence[Mapping[str, Any]]] = {}
    for scene in SCENES:
        link_folder(folder / "data" / "models", folder / scene / "data" / "models")
        shown = run_pipeline([*evaluations_in(scene)], folder / scene, on_progress)
        if shown is None:
            return None
        trials |= shown
    return trials


EXPERIMENT = OnePolicy()
