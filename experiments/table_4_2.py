"""Table 4.2: one policy from many, told its task as a text, as the nearest training text's number, or not at all.

Students of the same 18 teachers, which ship. Three seeds each, 50 episodes a task, 36 tasks, two kinds of starts.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.chapter4 import one_policy_report, students
from experiments.chapter4.eye_without_colour import eye_config, with_eye
from experiments.chapter4.shipped_teachers import shipped_teachers
from experiments.chapter4.students import (
    DATASET,
    DISSERTATION,
    DONE,
    EPISODES_OF_SCENE,
    EYE,
    IN_SCENES,
    OURS,
    RANDOM,
    RENAMED,
    SCENES,
    distil,
    done_evaluations,
    done_samples,
    evaluations,
    evaluations_in,
    figures,
    refit,
    refitted,
    renamed_evaluations,
    samples,
    samples_in_scenes,
    taught,
)
from experiments.chapter4.unseen_colour import check_unseen, scanned
from experiments.workbench.arms import Arm, Experiment
from experiments.workbench.configs import Config
from experiments.workbench.pipelines import Step, Trials, run_once, run_pipeline
from experiments.workbench.results import ArmResult, Outcome
from experiments.workbench.table import Table
from freerein.data import dataset_path

_WORLD, _SEEDS, _VERSION = "blocks", 3, 2
_ROWS = ((OURS, "text"), (OURS, "code"), (OURS, "none"), (DISSERTATION, "text"))
_TEXT, _TASKS = "conditioning", "tasks"
_STUDENTS = {IN_SCENES: OURS, DONE: OURS, EYE: OURS, RENAMED: DISSERTATION}
"""Whose student an arm evaluates, or fits again, other than its method's."""

_SAMPLES = {IN_SCENES: samples_in_scenes, DONE: done_samples}


class OnePolicy(Experiment):
    """An arm for each student, and one for random actions."""

    @property
    def arms(self) -> tuple[Arm, ...]:
        """Random actions, then all students of a seed, then those that are made of them or in other scenes."""
        return (
            Arm(_WORLD, RANDOM),
            *(Arm(_WORLD, method, {_TEXT: how}, seed) for seed in range(_SEEDS) for method, how in _ROWS),
            *(Arm(_WORLD, method, {_TEXT: "text"}, seed) for method in (DONE, IN_SCENES) for seed in range(_SEEDS)),
            *(Arm(_WORLD, method, {_TEXT: "text"}) for method in (EYE, RENAMED)),
        )

    def config(self, arm: Arm) -> Config:
        """Returns the teachers of a student, and the steps of the arm's pipeline; the scenes where it has some."""
        teachers = () if arm.method == RANDOM else shipped_teachers()
        more: dict[str, object] = {}
        if arm.method == IN_SCENES:
            more = {"scenes": list(SCENES), "episodes": EPISODES_OF_SCENE}
        elif arm.method == EYE:
            more = {"eye": eye_config(arm.seed)}
        return {"version": _VERSION, "teachers": list(teachers), "steps": list(_steps(arm)), **more}

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Evaluates a student, or random actions, on true states; see `Experiment`."""
        student = None if arm.method == RANDOM else _student(arm, work, on_progress)
        if student is None and arm.method != RANDOM:
            return None
        found = {f"scanned.{name}": value for name, value in scanned(student).items()} if student else {}
        if arm.method == EYE and student:
            student = with_eye(student, folder / "source", work, on_progress, seed=arm.seed)
            if student is None:
                return None
        trials = _trials(_pipelines(arm), student, folder, on_progress)
        if trials is None:
            return None
        return Outcome(dict(figures(trials)) | found, dict(_SAMPLES.get(arm.method, samples)(trials)))

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the table of the arms that have results."""
        return one_policy_report.table(results)


def _steps(arm: Arm) -> list[Step]:
    """Returns the steps that make the student of an arm, and those that evaluate it; scenes have theirs beside."""
    first = [] if arm.method == RANDOM else [_distil(arm)]
    return first if arm.method == IN_SCENES else [*first, *_pipelines(arm)[_TASKS]]


def _distil(arm: Arm) -> Step:
    return distil(_STUDENTS.get(arm.method, arm.method), arm.options[_TEXT], arm.seed)


def _pipelines(arm: Arm) -> dict[str, list[Step]]:
    """Returns the evaluations of an arm by the names of their pipelines: one of all scenes would be too long."""
    match arm.method:
        case students.IN_SCENES:
            return {scene: [*evaluations_in(scene)] for scene in SCENES}
        case students.DONE:
            return {_TASKS: [refit(arm.seed, says_when_done=True), *done_evaluations()]}
        case students.EYE:
            return {_TASKS: [refit(arm.seed), *evaluations(refitted())]}
        case students.RENAMED:
            return {_TASKS: [*renamed_evaluations()]}
    return {_TASKS: [*evaluations(RANDOM if arm.method == RANDOM else taught())]}


def _student(arm: Arm, work: Path, on_progress: Callable[[], None]) -> Path | None:
    """Distils a student, once for all its arms, and scans what it has learned from; returns the folder."""
    made_by = {"version": _VERSION, "teachers": list(shipped_teachers())}
    folder = run_once([_distil(arm)], made_by, work / "students", on_progress)
    if folder:
        check_unseen(dataset_path(folder / "data", DATASET), folder)
    return folder


def _trials(
    pipelines: Mapping[str, Sequence[Step]], student: Path | None, folder: Path, on_progress: Callable[[], None]
) -> Trials | None:
    """Runs evaluations by pipeline, each in a folder of its own; returns all trials, None when one was stopped."""
    trials: dict[str, Sequence[Mapping[str, Any]]] = {}
    for name, steps in pipelines.items():
        shown = run_pipeline(steps, folder / name, on_progress, source=student)
        if shown is None:
            return None
        trials |= shown
    return trials


EXPERIMENT = OnePolicy()
