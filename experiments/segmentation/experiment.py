"""An experiment on segmentation: {methods} x {contexts} x {seeds} on the demonstrations of worlds."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from experiments.segmentation import dataset, draw, evaluation, report, supervised, truth, weakly_supervised
from experiments.segmentation.dataset import SPLITS, DatasetSpec, SplitName
from experiments.segmentation.report import SUPERVISED, Report
from experiments.workbench.arms import Arm
from experiments.workbench.results import ArmResult, Outcome, Sample
from experiments.workbench.table import Table
from freerein.jobs.child import stop_on_sigterm
from freerein.learning.checkpoints import JSON
from freerein.learning.fit import Learner, fit
from freerein_segmentation.model import SegmentationNetwork
from freerein_segmentation.training import SegmentationConfig

GUESSES = {
    "random": evaluation.guess_skill,
    "random_cls": evaluation.guess_tag,
    "majority": evaluation.guess_majority,
}
"""Baselines without a network."""

Predict = Callable[[SplitName, int], Sequence[evaluation.Labels]]
"""Returns the labels of the first trajectories of a split, int64 (T,) each, given their number."""


@dataclass(frozen=True)
class SegmentationExperiment:
    """Arms of one world that differ in objective, context and seed.

    Attributes:
        data: The demonstrations.
        objectives: Objectives of the segmentation service.
        contexts: Contexts of its network.
        seeds: Number of independently trained networks of each, and of supervised ones.
        settings: Other keys of the segmentation service's configuration.
        train_evaluated: Number of training trajectories that are evaluated.
        report: The table's words and the dissertation's figures.
    """

    data: DatasetSpec
    objectives: tuple[str, ...]
    contexts: tuple[str, ...]
    seeds: int
    settings: Mapping[str, float]
    train_evaluated: int
    report: Report

    @property
    def arms(self) -> tuple[Arm, ...]:
        """Guesses, then all networks of a seed before those of the next."""
        guesses = [Arm(self.data.task, method) for method in GUESSES]
        networks = [
            Arm(self.data.task, method, {"context": context}, seed)
            for seed in range(self.seeds)
            for method in (*self.objectives, SUPERVISED)
            for context in self.contexts
        ]
        return (*guesses, *networks)

    @property
    def trajectories_seen(self) -> int:
        """Number of training trajectories that a network is trained on."""
        fit_config = SegmentationConfig.from_mapping(self.settings)
        return min(fit_config.steps * fit_config.batch_size, self.data.train.count)

    def config(self, arm: Arm) -> dict[str, JSON]:
        """Returns the data and, for a network, the segmentation service's configuration."""
        config: dict[str, JSON] = {"data": asdict(self.data), "train_evaluated": self.train_evaluated}
        if arm.method not in GUESSES:
            config["fit"] = {**asdict(self._fit_config(arm)), "objective": arm.method}
        return config

    def world_hash(self, world: str) -> str:
        """Returns the hash of what the world's generator draws."""
        return draw.world_hash(world)

    def prepare(self, work: Path) -> None:
        """Draws the demonstrations, or waits until another arm has drawn them."""
        dataset.open_or_draw(self.data, work)

    def run(self, arm: Arm, *, work: Path, folder: Path, on_progress: Callable[[], None]) -> Outcome | None:
        """Trains and evaluates an arm; see `Experiment`."""
        data = dataset.open_or_draw(self.data, work)
        predict = self._guess(arm, data) if arm.method in GUESSES else self._fit(arm, data, folder, on_progress)
        if predict is None:
            return None
        figures: dict[str, float] = {}
        samples: dict[str, Sample] = {}
        for split in SPLITS:
            count = self._evaluated(split)
            outcome = evaluation.score(predict(split, count), truth.first_labels(data, split, count), split=split)
            figures |= outcome.figures
            samples |= outcome.samples
        return Outcome(figures, samples)

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the table of the arms that have results."""
        by_name = {result.name: result for result in results}
        ordered = [by_name[arm.name] for arm in self.arms if arm.name in by_name]
        return report.table(self.report, ordered, trajectories_seen=self.trajectories_seen)

    def _fit_config(self, arm: Arm) -> SegmentationConfig:
        objective = {} if arm.method == SUPERVISED else {"objective": arm.method}
        return SegmentationConfig.from_mapping({**self.settings, **objective, **arm.options, "seed": arm.seed})

    def _evaluated(self, split: SplitName) -> int:
        count = self.data.split(split).count
        return min(count, self.train_evaluated) if split == "train" else count

    def _guess(self, arm: Arm, data: Path) -> Predict:
        """Returns guesses, which know the true labels: their lengths, their skills or the longest one."""
        guess, skills = GUESSES[arm.method], len(self.data.world.skills)
        rng = np.random.default_rng(arm.seed)
        return lambda split, count: [
            guess(each, skills=skills, rng=rng) for each in truth.first_labels(data, split, count)
        ]

    def _fit(self, arm: Arm, data: Path, folder: Path, on_progress: Callable[[], None]) -> Predict | None:
        """Returns the predictions of the trained network; None when training was stopped."""
        make: Callable[[SegmentationConfig, DatasetSpec, Path], Learner[SegmentationNetwork]]
        make = supervised.make_learner if arm.method == SUPERVISED else weakly_supervised.make_learner
        learner = make(self._fit_config(arm), self.data, data)
        with stop_on_sigterm() as stop:
            fitted = fit(learner, folder, stop=stop, on_event=lambda _: on_progress())
        if fitted is None:
            return None
        network = fitted.network

        return lambda split, count: evaluation.predict(network, dataset.open_split(data, self.data, split), count=count)
