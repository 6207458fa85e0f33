"""Evaluations of policies as steps of a pipeline, and what their confidence that a goal is reached is worth."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.robustness import confidence
from experiments.workbench.pipelines import Step, step
from experiments.workbench.results import Sample

FLAG_AUROC, FLAG_ECE, FLAG_RECALL = "flag.auroc", "flag.ece", "flag.recall"

_HELD_OUT_SEED = 1_000_003
_NUM_ENVS = 64
_PRECISION = 0.9


def evaluate(form: str, name: str = "", **config: Any) -> Step:
    """Returns the step that evaluates by a form, on seeds that no training has."""
    return step(name or form, "evaluate", form=form, num_envs=_NUM_ENVS, seed=_HELD_OUT_SEED, **config)


def flagged(trials: Sequence[Mapping[str, Any]], holds: str) -> Iterator[tuple[str, Sample]]:
    """Yields figures of the confidence in each frame of trials, beside whether the goal held there, under a key.

    There are none where it held nowhere, or in every frame.
    """
    trial = np.repeat(np.arange(len(trials)), [len(each["confidence"]) for each in trials])
    score = np.concatenate([np.array(each["confidence"], np.float64) for each in trials])
    right = np.concatenate([np.array(each[holds], np.bool_) for each in trials])
    if not right.any() or right.all():
        return
    yield FLAG_AUROC, confidence.auroc(score, right, trial)
    yield FLAG_ECE, confidence.calibration_error(score, right, trial)
    yield FLAG_RECALL, _recall(score, right, trial)


def _recall(score: npt.NDArray[np.float64], right: npt.NDArray[np.bool_], trial: npt.NDArray[np.int64]) -> Sample:
    """Returns the recall at the lowest threshold whose precision is high enough; the interval holds it fixed."""
    order = np.argsort(-score, kind="stable")
    last = np.append(np.diff(score[order]) < 0, True)  # equal scores are above a threshold together
    precision = np.cumsum(right[order]) / np.arange(1, len(order) + 1)
    enough = np.flatnonzero((precision >= _PRECISION) & last)
    threshold = score[order][enough[-1]] if len(enough) else np.inf
    return confidence.by_trial((score >= threshold) & right, right, trial)
