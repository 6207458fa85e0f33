"""Decodes skill probabilities into labels and segments: smoothing, argmax, merging, and rejection."""

import heapq
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from freerein.metrics import run_starts
from freerein.types.segmentation import NO_SKILL, Segment

Probabilities: TypeAlias = npt.NDArray[np.float32]
Labels: TypeAlias = npt.NDArray[np.int64]

_TRUNCATION = 4.0
"""Half-width of the Gaussian kernel in standard deviations; 6e-5 of its mass lies beyond."""


class Decoded(NamedTuple):
    """The labels of one trajectory.

    Attributes:
        labels: int64 (T,), skill index of each timestep; `NO_SKILL` where it was rejected.
        confidence: float32 (T,), smoothed probability of that skill, in [0, 1]; of the rejected one, where it was.
        segments: In order, without overlap; between them lie the rejected timesteps.
    """

    labels: Labels
    confidence: npt.NDArray[np.float32]
    segments: tuple[Segment, ...]


def decode(
    probabilities: Probabilities,
    *,
    skills: Sequence[str],
    smoothing: float,
    min_segment: int,
    min_confidence: float,
    min_kept: int,
) -> Decoded:
    """Returns the labels and segments of a trajectory with probabilities float32 (T, K), T at least 1.

    `smoothing`, `min_segment`, `min_confidence` and `min_kept` are those of `SegmentRequest`.
    """
    smoothed = smooth(probabilities, sigma=smoothing)
    labels = merge_short(smoothed.argmax(axis=1).astype(np.int64), smoothed, min_segment=min_segment)
    confidence = np.take_along_axis(smoothed, labels[:, None], axis=1)[:, 0].clip(max=1.0)  # rounding
    labels = reject_short(reject_uncertain(labels, confidence, min_confidence=min_confidence), min_kept=min_kept)
    return Decoded(labels, confidence, _segments(labels, confidence, skills))


def smooth(probabilities: Probabilities, *, sigma: float) -> Probabilities:
    """Returns probabilities (T, K) after a Gaussian filter over time, renormalised at both ends; rows still sum to one.

    `sigma` is in timesteps; below 1/8 nothing changes.
    """
    reach = smoothing_reach(sigma)
    if reach == 0 or not len(probabilities):
        return probabilities
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    timesteps = len(probabilities)

    def average(series: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
        return np.convolve(series, kernel)[reach : reach + timesteps]

    weights = average(np.ones(timesteps, np.float32))
    return np.stack([average(series) / weights for series in probabilities.T], axis=1).astype(np.float32)


def smoothing_reach(sigma: float) -> int:
    """Returns how many timesteps before and after each the filter of `smooth` reads."""
    return round(_TRUNCATION * sigma)


def merge_short(labels: Labels, probabilities: Probabilities, *, min_segment: int) -> Labels:
    """Returns labels (T,) whose runs all have at least `min_segment` timesteps, unless T is shorter.

    Repeatedly merges the shortest run (the earliest of equals) into the neighbour whose skill has the larger summed
    probability (T, K) over the run, until no run is too short or one is left.
    """
    runs = _Runs(labels, probabilities)
    short = [(length, run) for run, length in enumerate(runs.lengths()) if length < min_segment]
    heapq.heapify(short)
    while short and runs.count > 1:
        length, run = heapq.heappop(short)
        if runs.length(run) != length:  # stale entry: merged or grown since it was pushed
            continue
        joined = runs.merge(run)
        if runs.length(joined) < min_segment:
            heapq.heappush(short, (runs.length(joined), joined))
    return runs.labels()


def reject_uncertain(labels: Labels, confidence: npt.NDArray[np.float32], *, min_confidence: float) -> Labels:
    """Returns labels (T,) with `NO_SKILL` in place of those whose confidence, float32 (T,), is below the least."""
    return np.where(confidence >= min_confidence, labels, NO_SKILL)


def reject_short(labels: Labels, *, min_kept: int) -> Labels:
    """Returns labels (T,) with `NO_SKILL` in place of the runs that are shorter than `min_kept` timesteps."""
    starts = run_starts(labels)
    lengths = np.diff(starts, append=len(labels))
    return np.where(np.repeat(lengths >= min_kept, lengths), labels, NO_SKILL)


class _Runs:
    """Runs of equal labels as a linked list with O(1) merging; a run is identified by its initial index."""

    def __init__(self, labels: Labels, probabilities: Probabilities) -> None:
        self._starts = [*run_starts(labels).tolist(), len(labels)]
        self.count = len(self._starts) - 1
        self._skill: list[int] = labels[self._starts[:-1]].tolist()
        self._end = self._starts[1:]
        self._before = list(range(-1, self.count - 1))
        self._after = [*range(1, self.count), -1]
        self._alive = [True] * self.count
        zero = np.zeros((1, probabilities.shape[1]))
        self._mass = np.concatenate([zero, probabilities.cumsum(axis=0, dtype=np.float64)])  # (T + 1, K)

    def lengths(self) -> list[int]:
        return [self.length(run) for run in range(len(self._skill))]

    def length(self, run: int) -> int:
        """Returns the number of timesteps of a run, 0 after it was merged into another."""
        return self._end[run] - self._starts[run] if self._alive[run] else 0

    def merge(self, run: int) -> int:
        """Merges a run into its better neighbour and returns the identifier of the merged run."""
        neighbours = [side for side in (self._before[run], self._after[run]) if side >= 0]
        mass = self._mass[self._end[run]] - self._mass[self._starts[run]]
        self._skill[run] = max((self._skill[side] for side in neighbours), key=mass.__getitem__)
        for side in neighbours:
            if self._skill[side] == self._skill[run]:
                run = self._join(min(run, side), max(run, side))
        return run

    def labels(self) -> Labels:
        alive = [run for run, lives in enumerate(self._alive) if lives]
        return np.repeat(np.array([self._skill[run] for run in alive], np.int64), [self.length(run) for run in alive])

    def _join(self, first: int, second: int) -> int:
        self._end[first] = self._end[second]
        self._after[first] = self._after[second]
        if self._after[second] >= 0:
            self._before[self._after[second]] = first
        self._alive[second] = False
        self.count -= 1
        return first


def _segments(labels: Labels, confidence: npt.NDArray[np.float32], skills: Sequence[str]) -> tuple[Segment, ...]:
    starts = run_starts(labels).tolist()
    return tuple(
        Segment(start, end, skills[labels[start]], float(confidence[start:end].mean()))
        for start, end in zip(starts, [*starts[1:], len(labels)], strict=True)
        if labels[start] != NO_SKILL
    )
