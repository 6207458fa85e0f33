"""Evaluation metrics of labels and scores against ground truth. Never used to select models.

Every metric raises InvalidInput for empty arrays, and for arrays of other shapes than its docstring names.
"""

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput

Labels: TypeAlias = npt.NDArray[np.integer[Any]]

_NORMAL_95 = 1.959964
"""Standard deviations of a normal distribution that hold 95 % of it."""

_DRAWN_AT_ONCE = 1_000_000
"""Numbers of a bootstrap's resamples in memory at once."""


def run_starts(labels: Labels) -> npt.NDArray[np.int64]:
    """Returns the start of each maximal run of equal labels: int64 (S,), for labels (T,)."""
    changes = np.flatnonzero(labels[1:] != labels[:-1]) + 1
    return np.concatenate([np.zeros(min(len(labels), 1), np.int64), changes.astype(np.int64)])


def frame_accuracy(predicted: Labels, truth: Labels) -> float:
    """Returns the fraction of correctly labelled timesteps, for labels (T,) each."""
    _check_pair(predicted, truth)
    return float(np.mean(predicted == truth))


def random_cls_accuracy(truth: Labels) -> float:
    """Returns the frame accuracy of uniform guessing among the skills that occur: 1 / their number (Random-Cls)."""
    _check_pair(truth, truth)
    return 1.0 / len(np.unique(truth))


def edit_score(predicted: Labels, truth: Labels) -> float:
    """Returns the edit score of the segment sequences, in [0, 1].

    One minus their Levenshtein distance divided by the length of the longer sequence.
    """
    _check_pair(predicted, truth)
    ours, theirs = predicted[run_starts(predicted)], truth[run_starts(truth)]
    return 1.0 - _levenshtein(ours.tolist(), theirs.tolist()) / max(len(ours), len(theirs))


def f1_at(predicted: Labels, truth: Labels, *, overlap: float) -> float:
    """Returns the segmental F1 score, in [0, 1]; F1@50 is `overlap=0.5`.

    A predicted segment is a true positive when its intersection over union with the true segment of its label that it
    overlaps most is at least `overlap`, in (0, 1], and that segment is not matched yet.
    """
    _check_pair(predicted, truth)
    if not 0.0 < overlap <= 1.0:
        raise InvalidInput(f"`overlap` must be in (0, 1]; got {overlap:g}.", field="overlap", hint="F1@50 has 0.5.")
    ours, theirs = _spans(predicted), _spans(truth)
    found: set[int] = set()
    for start, end, label in ours:
        scores = [
            (min(end, true_end) - max(start, true_start)) / (max(end, true_end) - min(start, true_start))
            if label == true_label
            else -1.0
            for true_start, true_end, true_label in theirs
        ]
        best = int(np.argmax(scores))
        if scores[best] >= overlap and best not in found:
            found.add(best)
    return 2 * len(found) / (len(ours) + len(theirs))


def auroc(scores: npt.NDArray[np.floating[Any]], truth: npt.NDArray[np.bool_]) -> float:
    """Returns the area under the ROC curve of scores, float (N,), for bool (N,) of both classes; ties count half."""
    if scores.ndim != 1 or scores.shape != truth.shape or not 0 < truth.sum() < len(truth):
        raise InvalidInput(
            f"Scores and truth must both be (N,), with true and false ones; got {scores.shape} and {truth.shape}, "
            f"{int(truth.sum())} of them true.",
            field="truth",
            hint="Score examples of both classes together.",
        )
    _, places, counts = np.unique(scores, return_inverse=True, return_counts=True)
    ranks = (counts.cumsum() - (counts - 1) / 2)[places]  # (N,), from 1; ties share their mean rank
    positives = int(truth.sum())
    above = ranks[truth].sum() - positives * (positives + 1) / 2
    return float(above / (positives * (len(truth) - positives)))


def average_precision(scores: npt.NDArray[np.floating[Any]], truth: npt.NDArray[np.bool_]) -> float:
    """Returns the area under the precision-recall steps of scores, float (N,), for bool (N,), at least one true.

    Examples of equal scores are found together. A constant score has the share of true examples.
    """
    if scores.ndim != 1 or scores.shape != truth.shape or not truth.any():
        raise InvalidInput(
            f"Scores and truth must both be (N,), with a true one; got {scores.shape} and {truth.shape}, "
            f"{int(truth.sum())} of them true.",
            field="truth",
            hint="Score at least one example that is true.",
        )
    _, places = np.unique(-scores, return_inverse=True)
    found = np.bincount(places, minlength=places.max() + 1).cumsum()  # examples at or above each distinct score
    hits = np.bincount(places, weights=truth)
    return float((hits * hits.cumsum() / found).sum() / truth.sum())


def majority_accuracy(truth: Labels) -> float:
    """Returns the accuracy of always answering the most frequent of the true labels (T,), in [0, 1]."""
    _check_pair(truth, truth)
    return float(np.unique(truth, return_counts=True)[1].max() / len(truth))


def balanced_accuracy(predicted: Labels, truth: Labels) -> float:
    """Returns the mean recall over the classes in `truth`; a constant answer scores one over their number."""
    _check_pair(predicted, truth)
    return float(np.mean([np.mean(predicted[truth == label] == label) for label in np.unique(truth)]))


def expected_calibration_error(
    confidence: npt.NDArray[np.floating[Any]], truth: npt.NDArray[np.bool_], *, bins: int = 10
) -> float:
    """Returns the expected calibration error (ECE): the mean gap between confidence and frequency, 0 is calibrated.

    `confidence` holds predicted probabilities, float (N,) in [0, 1]; `truth`, bool (N,), whether each came true. The
    bins have equal width.
    """
    if confidence.ndim != 1 or confidence.shape != truth.shape or not len(truth):
        raise InvalidInput(
            f"Confidence and truth must both be (N,), N at least 1; got {confidence.shape} and {truth.shape}.",
            field="confidence",
            hint="Give one confidence per outcome.",
        )
    members = np.minimum((confidence * bins).astype(np.int64), bins - 1)
    gaps = np.bincount(members, weights=confidence - truth, minlength=bins)  # (bins,), summed over each bin
    return float(np.abs(gaps).sum() / len(truth))


def median_interval(values: npt.ArrayLike) -> tuple[float, float]:
    """Returns the 95 % interval of the median of independent values (N,), by order statistics.

    Its ends are the values of the ranks N / 2 - 1.96 sqrt(N) / 2 and 1 + N / 2 + 1.96 sqrt(N) / 2, rounded, and within
    1 to N (Campbell and Gardner 1988).
    """
    sample = np.sort(np.asarray(values, np.float64))
    if sample.ndim != 1 or not len(sample):
        raise InvalidInput(f"Values must be (N,), N at least 1; got {sample.shape}.", field="values")
    count = len(sample)
    aside = _NORMAL_95 * math.sqrt(count) / 2
    low, high = round(count / 2 - aside), round(1 + count / 2 + aside)
    return float(sample[max(low, 1) - 1]), float(sample[min(high, count) - 1])


def mean_interval(values: npt.ArrayLike, *, rng: np.random.Generator, resamples: int = 10_000) -> tuple[float, float]:
    """Returns the 95 % interval of the mean of independent values (N,), by percentile bootstrap."""
    sample = np.asarray(values, np.float64)
    if sample.ndim != 1 or not len(sample):
        raise InvalidInput(f"Values must be (N,), N at least 1; got {sample.shape}.", field="values")
    at_once = max(1, _DRAWN_AT_ONCE // len(sample))
    means = [
        rng.choice(sample, (min(at_once, resamples - first), len(sample))).mean(axis=1)
        for first in range(0, resamples, at_once)
    ]
    low, high = np.percentile(np.concatenate(means), [2.5, 97.5])
    return float(low), float(high)


def ratio_interval(
    part: npt.ArrayLike, whole: npt.ArrayLike, *, rng: np.random.Generator, resamples: int = 10_000
) -> tuple[float, float]:
    """Returns the 95 % interval of a mean of ratios over N independent trials, by percentile bootstrap.

    Each of C classes has the ratio of the sums of `part` and `whole`, numbers (N, C) each, such as the correct and all
    answers of a trial; accuracy has one class, balanced accuracy one per label. Classes absent from a resample do not
    count in it.
    """
    parts, wholes = np.asarray(part, np.float64), np.asarray(whole, np.float64)
    if parts.ndim != 2 or parts.shape != wholes.shape or not parts.size:
        raise InvalidInput(
            f"`part` and `whole` must both be (N, C), N and C at least 1; got {parts.shape} and {wholes.shape}.",
            field="part",
        )
    trials = len(parts)
    both = np.concatenate([parts, wholes], axis=1)
    at_once = max(1, _DRAWN_AT_ONCE // trials)
    drawn = [
        rng.multinomial(trials, np.full(trials, 1 / trials), size=min(at_once, resamples - first)) @ both
        for first in range(0, resamples, at_once)
    ]
    sums, totals = np.split(np.concatenate(drawn), 2, axis=1)  # (resamples, C) each
    present = totals > 0
    counted = present.any(axis=1)
    ratios = np.divide(sums, totals, out=np.zeros_like(sums), where=present)[counted]
    low, high = np.percentile(ratios.sum(axis=1) / present[counted].sum(axis=1), [2.5, 97.5])
    return float(low), float(high)


def wilson_interval(count: int, of: int) -> tuple[float, float]:
    """Returns the 95 % interval of a share by Wilson's score (1927): of trials, of which there is at least one.

    Args:
        count: Successes.
        of: Trials.
    """
    if of < 1 or not 0 <= count <= of:
        raise InvalidInput(f"A share must be of at least one trial, and at most 1; got {count} of {of}.")
    share, weight = count / of, _NORMAL_95**2 / of
    centre = (share + weight / 2) / (1 + weight)
    half = (share * (1 - share) * weight + weight**2 / 4) ** 0.5 / (1 + weight)
    return max(0.0, centre - half), min(1.0, centre + half)


def _check_pair(predicted: Labels, truth: Labels) -> None:
    if predicted.ndim != 1 or predicted.shape != truth.shape or len(truth) == 0:
        raise InvalidInput(
            f"Predicted and true labels must both be (T,), T at least 1; got {predicted.shape} and {truth.shape}.",
            field="labels",
            hint="Compare the labels of one trajectory at a time.",
        )


def _spans(labels: Labels) -> list[tuple[int, int, int]]:
    starts = run_starts(labels)
    ends = [*starts[1:].tolist(), len(labels)]
    return list(zip(starts.tolist(), ends, labels[starts].tolist(), strict=True))


def _levenshtein(ours: Sequence[int], theirs: Sequence[int]) -> int:
    row = list(range(len(theirs) + 1))
    for i, mine in enumerate(ours, start=1):
        diagonal, row[0] = row[0], i
        for j, yours in enumerate(theirs, start=1):
            diagonal, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, diagonal + (mine != yours))
    return row[-1]
