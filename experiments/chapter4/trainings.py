"""Experiments whose arms train a policy on a reward, and evaluate it: the method of an arm is its reward."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.chapter4 import trained_on
from experiments.workbench.arms import Arm, Experiment
from experiments.workbench.configs import Config
from experiments.workbench.pipelines import run_once, run_pipeline
from experiments.workbench.results import ArmResult, Outcome
from experiments.workbench.table import Table

_SHARED_VERSION = 1
_VERSIONS = {trained_on.PUSH: 2}
"""Versions of trainings by world, 1 where none is given; raised where their code learns otherwise."""


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
        """Returns the steps of the arm's pipeline, and of the one that makes what it begins with."""
        shared = trained_on.shared_steps(arm)
        version = _VERSIONS.get(arm.world, 1)
        return {"version": version, **({"shared": shared} if shared else {}), "steps": trained_on.steps(arm)}

    def prepare(self, arm: Arm, work: Path) -> bool:
        """Makes what the trainings of a seed begin with, or waits until another arm has made it."""
        return not trained_on.shared_steps(arm) or self._shared(arm, work) is not None

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Trains a policy, and evaluates it on true states; see `Experiment`."""
        has_examples = arm.method == trained_on.VICE
        source = self._shared(arm, work) if trained_on.shared_steps(arm) else None
        trials = run_pipeline(trained_on.steps(arm), folder, on_progress, source=source, keeps_datasets=has_examples)
        if trials is None:
            return None
        told = trained_on.classifier_samples(folder / "data", seed=arm.seed) if has_examples else ()
        return Outcome({}, {**dict(trained_on.samples(trials)), **dict(told)})

    def _shared(self, arm: Arm, work: Path) -> Path | None:
        """Returns the folder of the pipeline that makes what an arm begins with; None when it was stopped."""
        return run_once(trained_on.shared_steps(arm), {"version": _SHARED_VERSION}, work / "trainings", lambda: None)

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the table of the arms that have results."""
        return self.report(results)
