"""Experiments whose arms train a policy on a reward, and evaluate it: the method of an arm is its reward."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.chapter4 import trained_on
from experiments.workbench.arms import Arm, Experiment
from experiments.workbench.configs import Config
from experiments.workbench.pipelines import run_pipeline
from experiments.workbench.results import ArmResult, Outcome
from experiments.workbench.table import Table

_VERSION = 1


@dataclass(frozen=True)
class Trainings(Experiment):
    """An arm for each training.

    Attributes:
        trainings: The arms.
        report: Returns the table of results.
    """

    trainings: tuple[Arm, ...]
    report: Callable[[Sequence[ArmResult]], Table]

    @property
    def arms(self) -> tuple[Arm, ...]:
        """The arms."""
        return self.trainings

    def config(self, arm: Arm) -> Config:
        """Returns the steps of the arm's pipeline."""
        return {"version": _VERSION, "steps": trained_on.steps(arm)}

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Trains a policy, and evaluates it on true states; see `Experiment`."""
        has_examples = arm.method == trained_on.VICE
        trials = run_pipeline(trained_on.steps(arm), folder, on_progress, keeps_datasets=has_examples)
        if trials is None:
            return None
        told = trained_on.classifier_samples(folder / "data", seed=arm.seed) if has_examples else ()
        return Outcome({}, {**dict(trained_on.samples(trials)), **dict(told)})

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the table of the arms that have results."""
        return self.report(results)
