"""Calibration and AUROC of a model's in-distribution score, over the answers under all conditions; as samples by trial.

AUROC and expected calibration error are no ratios of sums over trials. Each is written as one that equals it: the AUROC
as the mean over wrong answers of the share of right ones with a higher score, the calibration error with the sign of
each bin's gap. Their intervals so hold the right answers' scores, and these signs, fixed.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from experiments.workbench.results import Sample
from freerein.types.segmentation import FLAGGED

AUROC, FLAGGED_SHARE, CALIBRATION_ERROR = (f"in_distribution.{name}" for name in ("auroc", "flagged", "ece"))
UNDER_05 = "in_distribution.under-0.05"
"""Share of nominal answers under 0.05: answers were flagged there until too many were."""

_BINS = 15
_DECIMALS = 6

Numbers = npt.NDArray[np.floating]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Answers:
    """Answers of a model under one condition.

    Attributes:
        right: bool (N,).
        confidence: float (N,) in [0, 1].
        score: float (N,), in-distribution score.
        trial: int64 (N,), the trial of each, from 0.
    """

    right: Flags
    confidence: Numbers
    score: Numbers
    trial: npt.NDArray[np.int64]


def pool(parts: Iterable[Answers]) -> Answers:
    """Returns the answers under several conditions; a trial is one under one of them."""
    parts = list(parts)
    offsets = np.cumsum([0, *(each.trial.max() + 1 for each in parts)])
    right, confidence, score, trial = (
        np.concatenate([getattr(each, name) for each in parts]) for name in ("right", "confidence", "score", "trial")
    )
    return Answers(right, confidence, score, trial + np.repeat(offsets[:-1], [len(each.trial) for each in parts]))


def samples(answers: Answers, *, nominal: Answers) -> dict[str, Sample]:
    """Returns AUROC of scores of right against wrong answers, the share of nominal ones flagged, and ECE of the rest.

    `answers` are those under all conditions, of which AUROC and ECE are.
    """
    kept = answers.score >= FLAGGED
    return {
        AUROC: auroc(answers.score, answers.right, answers.trial),
        FLAGGED_SHARE: by_trial(nominal.score < FLAGGED, np.ones(len(nominal.score)), nominal.trial),
        UNDER_05: by_trial(nominal.score < 0.05, np.ones(len(nominal.score)), nominal.trial),
        CALIBRATION_ERROR: calibration_error(answers.confidence[kept], answers.right[kept], answers.trial[kept]),
    }


def auroc(score: Numbers, right: Flags, trial: npt.NDArray[np.int64]) -> Sample:
    """Returns the AUROC of scores of N answers, right against wrong ones; `trial` is the trial of each, from 0."""
    wrong, of_right = ~right, np.sort(score[right])
    above, at_least = (len(of_right) - of_right.searchsorted(score, side) for side in ("right", "left"))
    shares = (above + at_least) / (2 * len(of_right))  # of right answers with a higher score, ties by half
    return by_trial(np.where(wrong, shares, 0.0), wrong, trial)


def calibration_error(confidence: Numbers, right: Flags, trial: npt.NDArray[np.int64]) -> Sample:
    """Returns the expected calibration error of the confidence in N answers; `trial` is the trial of each, from 0."""
    return by_trial(_signed_gaps(confidence, right), np.ones(len(right)), trial)


def by_trial(totals: npt.NDArray[Any], counts: npt.NDArray[Any], trial: npt.NDArray[np.int64]) -> Sample:
    """Returns sums over the answers of each trial that has some to count."""
    sums = [np.bincount(trial, weights=np.asarray(each, np.float64)) for each in (totals, counts)]
    has_some = sums[1] > 0
    return Sample(*(np.round(each[has_some], _DECIMALS).tolist() for each in sums))


def _signed_gaps(confidence: Numbers, right: Flags) -> npt.NDArray[np.float64]:
    """Returns what each answer adds to the expected calibration error times N, float64 (N,)."""
    bins = np.minimum((confidence * _BINS).astype(np.int64), _BINS - 1)
    gaps = confidence.astype(np.float64) - right
    signs = np.sign(np.bincount(bins, weights=gaps, minlength=_BINS))
    signed: npt.NDArray[np.float64] = signs[bins] * gaps
    return signed
