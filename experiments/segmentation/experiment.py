"""An experiment on segmentation: methods in their contexts, with several seeds, on the demonstrations of worlds."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from experiments.segmentation import (
    dataset,
    evaluation,
    report,
    served,
    supervised,
    trials,
    truth,
    weakly_supervised,
)
from experiments.segmentation.dataset import SPLITS, DatasetSpec, SplitName
from experiments.segmentation.effects import under
from experiments.segmentation.guesses import GUESSES, TRUTH
from experiments.segmentation.packed import PACKED, PACKED_DECODED, pack
from experiments.segmentation.report import Report
from experiments.segmentation.study import ACTION_STEPS, SUPERVISED, Study
from experiments.workbench.arms import Arm, Experiment
from experiments.workbench.configs import Config
from experiments.workbench.results import ArmResult, Outcome
from experiments.workbench.table import Table
from freerein.jobs.child import stop_on_sigterm
from freerein.learning.checkpoints import JSON
from freerein.learning.learner import Learner
from freerein.learning.model_files import choose_device
from freerein.learning.training_loop import FitResult, TrainingFailed, fit
from freerein_segmentation.model import ModelSpec, SegmentationNetwork
from freerein_segmentation.training import SegmentationConfig, SegmentationLearner, held_out_action_loss

SHOWN_LABELS = "test.labels"
"""Name of a network's labels of the first test trajectories."""

_SHOWN = 4
_LABELLED: tuple[SplitName, ...] = ("train", "validation")

_MOST_WORSE, _NEGLIGIBLE = 1.02, 0.01
"""Of a trial's loss, and nats more: a whole fit that ends above that had too high a rate."""

Fitted = FitResult[SegmentationNetwork]
WorkbenchLearner = SegmentationLearner | supervised.SupervisedLearner


@dataclass(frozen=True)
class ArmConfig:
    """The configuration that an arm's result depends on.

    Attributes:
        data: The demonstrations.
        train_evaluated: Number of training trajectories that are evaluated.
        fit: The fit of its network; None for a guess.
        trials: Learning rates that are tried before, and the steps of each; None where nothing is.
        action_steps: As in `Study`.
        sees_frames: As in `Study`.
    """

    data: DatasetSpec
    train_evaluated: int
    fit: SegmentationConfig | None = None
    trials: Mapping[str, object] | None = None
    action_steps: int = ACTION_STEPS
    sees_frames: bool = True


@dataclass(frozen=True)
class SegmentationExperiment(Experiment):
    """Studies of some worlds, and the table of their arms.

    Attributes:
        studies: The studies, of one world each.
        report: The table's words, the dissertation's figures, and the claims.
        sources: As in `Experiment`; the development world says by how much labels are moved.
    """

    studies: tuple[Study, ...]
    report: Report
    sources: tuple[str, ...] = ()

    @property
    def arms(self) -> tuple[Arm, ...]:
        """The arms of each study in turn."""
        return tuple(arm for study in self.studies for arm in study.arms)

    def config(self, arm: Arm) -> Config:
        """Returns the data and, for a network, the segmentation service's configuration and what is tried."""
        study = self._study(arm.world)
        guessed = ArmConfig(study.data, study.train_evaluated)
        if study.is_guess(arm):
            return guessed
        is_tried = study.tries_learning_rates(arm)
        tried = {"learning_rates": study.learning_rates, "steps": study.trial_steps} if is_tried else None
        return replace(
            guessed,
            fit=study.fit_config(arm),
            trials=tried,
            action_steps=study.action_steps,
            sees_frames=study.sees_frames(arm),
        )

    def prepare(self, arm: Arm, work: Path) -> bool:
        """Draws the demonstrations, or waits until another arm has drawn them."""
        dataset.open_or_draw(self._study(arm.world).data, work)
        return True

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Trains and evaluates an arm; see `Experiment`."""
        study = self._study(arm.world)
        data = dataset.open_or_draw(study.data, work)
        if study.is_guess(arm):
            return _guess(study, arm, data)

        def fit_trial(config: SegmentationConfig, place: Path) -> float | None:
            fitted = _fit(_learner(study, arm, config, data), place, on_progress)
            return None if fitted is None else fitted.validation_loss

        config = study.fit_config(arm)
        lrs: dict[float, float] | None = {config.lr: math.inf}
        if study.tries_learning_rates(arm):
            lrs = trials.rank_lrs(study, arm, fit_trial, results=results, work=work)
        if lrs is None:
            return None
        learner, fitted = fit_in_turn(
            lambda lr: _learner(study, arm, replace(config, lr=lr), data), lrs, folder, on_progress
        )
        if fitted is None:
            return None
        outcome = _evaluate(study, arm, fitted, learner.config, data)
        if isinstance(learner, SegmentationLearner):
            outcome = _joined([outcome, evaluation.score_confidence(learner.confidence(fitted))])
            command = f"python -m experiments run {self.report.experiment} --only {arm.name}"
            served.save(study, learner, fitted, folder / "model", figures=outcome.figures, command=command)
        return outcome

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the table of the arms that have results, which may be those of `sources`, too."""
        order = {arm.name: place for place, arm in enumerate(self.arms)}
        ordered = sorted(results, key=lambda result: order.get(result.name, len(order)))
        return report.table(self.report, self.studies, ordered)

    def _study(self, world: str) -> Study:
        (study,) = (study for study in self.studies if study.world == world)
        return study


def fit_in_turn(
    make_learner: Callable[[float], WorkbenchLearner],
    lrs: Mapping[float, float],
    folder: Path,
    on_progress: Callable[[], None],
) -> tuple[WorkbenchLearner, Fitted | None]:
    """Fits with the first learning rate with which training neither fails nor ends worse than the rate's trial did.

    A trial is shorter: a rate may do for it, and be too high for the whole fit, which stays at its peak for longer.
    Where all end worse, the fit of the lowest loss is taken.

    Args:
        make_learner: Returns the learner of a learning rate.
        lrs: The learning rates, and the loss of each one's trial, which counts where the fit's compares with it.
        folder: Of the fits.
        on_progress: Called often.

    Returns:
        The learner, and what it found; None for the latter when the fit was stopped.

    Raises:
        TrainingFailed: Training fails with all.
    """
    failed: TrainingFailed | None = None
    worse: list[tuple[WorkbenchLearner, Fitted]] = []
    for lr, trial_loss in lrs.items():
        try:
            learner = make_learner(lr)
            fitted = _fit(learner, folder / f"lr-{lr:g}", on_progress)
        except TrainingFailed as error:
            failed = error
            continue
        most = _MOST_WORSE * trial_loss + _NEGLIGIBLE if trials.ends_with_tags(learner.config) else math.inf
        if fitted is None or fitted.validation_loss <= most:
            return learner, fitted
        worse.append((learner, fitted))
    if failed and not worse:
        raise failed
    return min(worse, key=lambda found: found[1].validation_loss)


def _guess(study: Study, arm: Arm, data: Path) -> Outcome:
    guess, skills, rng = GUESSES[arm.method], len(study.data.world.skills), np.random.default_rng(arm.seed)
    parts = []
    for split in SPLITS:
        known = truth.first_labels(data, split, _evaluated(study, split))
        guessed = [guess(each, skills=skills, rng=rng) for each in known]
        parts.append(evaluation.score_guess(guessed, known, split=split))
        if arm.method == TRUTH:
            parts.append(Outcome({}, {}, {f"{split}.{PACKED}": pack(known)}))
    return _joined(parts)


def _learner(study: Study, arm: Arm, config: SegmentationConfig, data: Path) -> WorkbenchLearner:
    if arm.method == SUPERVISED:
        return supervised.make_learner(config, study.data, data)
    return weakly_supervised.make_learner(config, study.data, data, sees_frames=study.sees_frames(arm))


def _fit(learner: Learner[SegmentationNetwork], folder: Path, on_progress: Callable[[], None]) -> Fitted | None:
    """Returns what a fit found; None when it was stopped."""
    with stop_on_sigterm() as stop:
        return fit(learner, folder, stop=stop, on_event=lambda _: on_progress())


def _evaluate(study: Study, arm: Arm, fitted: Fitted, config: SegmentationConfig, data: Path) -> Outcome:
    chosen = {"lr": config.lr, "best_step": float(fitted.best_step), evaluation.TAG_LOSS: fitted.validation_loss}
    parts, labels, decoded = [Outcome(chosen, {})], {}, {}
    for split in SPLITS:
        count = _evaluated(study, split)
        seen = dataset.open_split(data, study.data, split, sees_frames=study.sees_frames(arm))
        predicted = evaluation.predict(fitted.network, seen, count=count)
        labels[split] = [each.argmax(axis=1) for each in predicted]
        decoded[split] = [evaluation.decode(each) for each in predicted]
        parts.append(evaluation.score(predicted, decoded[split], truth.first_labels(data, split, count), split=split))
    shown: dict[str, JSON] = {
        SHOWN_LABELS: [each.tolist() for each in labels["test"][:_SHOWN]],
        f"test.{PACKED}": pack(labels["test"]),
        f"test.{PACKED_DECODED}": pack(decoded["test"]),
    }
    parts += [_evaluate_under(name, study, arm, fitted, data) for name in study.effects(arm)]
    figures = {evaluation.ACTION_LOSS: _action_loss(study, labels, spec=fitted.network.spec, data=data)}
    if arm.method != SUPERVISED:
        validation = dataset.open_split(data, study.data, "validation")
        tags = np.array([[skill in each for skill in study.data.world.skills] for each in validation.skills])
        figures[evaluation.GUESSED_TAG_LOSS] = round(evaluation.guessed_tag_loss(config, tags), 6)
    return _joined([*parts, Outcome(figures, {}, shown)])


def _evaluate_under(effect: str, study: Study, arm: Arm, fitted: Fitted, data: Path) -> Outcome:
    seen = dataset.open_split(data, study.data, "test", sees_frames=study.sees_frames(arm))
    count = _evaluated(study, "test")
    predicted = evaluation.predict(fitted.network, under(study.effects(arm)[effect], seen), count=count)
    labels = [each.argmax(axis=1) for each in predicted]
    return evaluation.score_guess(labels, truth.first_labels(data, "test", count), split=f"test.{effect}")


def _action_loss(
    study: Study, labels: Mapping[SplitName, Sequence[evaluation.Labels]], *, spec: ModelSpec, data: Path
) -> float:
    """Returns how badly the labels explain held-out actions; they compare between methods and contexts."""
    training, validation = (
        dataset.open_split(data, study.data, split).subset(range(len(labels[split]))) for split in _LABELLED
    )
    loss = held_out_action_loss(
        training,
        labels["train"],
        validation,
        labels["validation"],
        spec=spec,
        steps=study.action_steps,
        seed=0,
        device=choose_device("auto"),
    )
    return round(loss, 6)


def _evaluated(study: Study, split: SplitName) -> int:
    count = study.data.split(split).count
    return min(count, study.train_evaluated) if split == "train" else count


def _joined(parts: Sequence[Outcome]) -> Outcome:
    return Outcome(
        {name: value for part in parts for name, value in part.figures.items()},
        {name: sample for part in parts for name, sample in part.samples.items()},
        {name: value for part in parts for name, value in part.shown.items()},
    )
