"""From probabilities to labels and segments: smooth over time, take the likeliest skill, merge what is too short."""

import heapq
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from freerein.metrics import run_starts

Probabilities: TypeAlias = npt.NDArray[np.float32]
Labels: TypeAlias = npt.NDArray[np.int64]

_REACH = 4.0
"""How many standard deviations the Gaussian reaches to each side; beyond lie 6e-5 of its mass."""


@dataclass(frozen=True)
class Span:
    """A maximal run of timesteps with one skill.

    Attributes:
        start: First timestep.
        end: One past the last timestep.
        skill: Index of the skill.
        confidence: Mean confidence of its timesteps, in [0, 1].
    """

    start: int
    end: int
    skill: int
    confidence: float


class Decoded(NamedTuple):
    """What one trajectory was labelled with.

    Attributes:
        labels: int64 (T,), the skill of each timestep.
        confidence: float32 (T,), the smoothed probability of that skill, in [0, 1].
        spans: In order; together they cover [0, T) without gap or overlap.
    """

    labels: Labels
    confidence: npt.NDArray[np.float32]
    spans: tuple[Span, ...]


def decode(probabilities: Probabilities, *, smoothing: float, min_segment: int) -> Decoded:
    """Returns the labels and segments of a trajectory.

    Args:
        probabilities: float32 (T, K), T at least 1, each row summing to one.
        smoothing: Standard deviation of the Gaussian that smooths them over time, in timesteps; 0 for none.
        min_segment: Segments shorter than this many timesteps are merged into their neighbours.
    """
    smoothed = smooth(probabilities, sigma=smoothing)
    labels = merge_short(smoothed.argmax(axis=1).astype(np.int64), smoothed, min_segment=min_segment)
    confidence = np.take_along_axis(smoothed, labels[:, None], axis=1)[:, 0].clip(max=1.0)  # rounding
    return Decoded(labels, confidence, _spans(labels, confidence))


def smooth(probabilities: Probabilities, *, sigma: float) -> Probabilities:
    """Returns probabilities (T, K) averaged over time with Gaussian weights; rows still sum to one.

    At the ends the weights that fall outside are left out and the others made to sum to one again.

    Args:
        probabilities: float32 (T, K).
        sigma: Standard deviation in timesteps; what is below an eighth changes nothing.
    """
    reach = round(_REACH * sigma)
    if reach == 0:
        return probabilities
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    timesteps = len(probabilities)

    def average(series: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
        return np.convolve(series, kernel)[reach : reach + timesteps]

    weights = average(np.ones(timesteps, np.float32))
    return np.stack([average(series) / weights for series in probabilities.T], axis=1).astype(np.float32)


def merge_short(labels: Labels, probabilities: Probabilities, *, min_segment: int) -> Labels:
    """Returns labels (T,) whose runs all have at least `min_segment` timesteps, where T allows it.

    The shortest run is taken first, the earliest of equals. It gets the label of the neighbour that the probabilities
    (T, K) like better over its timesteps, and joins it; so on until none is too short or one run is left.
    """
    runs = _Runs(labels, probabilities)
    short = [(length, run) for run, length in enumerate(runs.lengths()) if length < min_segment]
    heapq.heapify(short)
    while short and runs.count > 1:
        length, run = heapq.heappop(short)
        if runs.length(run) != length:  # it has been joined, or has grown, since it was put here
            continue
        joined = runs.merge(run)
        if runs.length(joined) < min_segment:
            heapq.heappush(short, (runs.length(joined), joined))
    return runs.labels()


class _Runs:
    """Runs of equal labels as a linked list; a run is named by its place among the runs at first. Merging is O(1)."""

    def __init__(self, labels: Labels, probabilities: Probabilities) -> None:
        self._starts = [*run_starts(labels).tolist(), len(labels)]
        self.count = len(self._starts) - 1
        self._skill: list[int] = labels[self._starts[:-1]].tolist()
        self._end = self._starts[1:]
        self._before = list(range(-1, self.count - 1))
        self._after = [*range(1, self.count), -1]
        self._alive = [True] * self.count
        none_yet = np.zeros((1, probabilities.shape[1]))
        self._mass = np.concatenate([none_yet, probabilities.cumsum(axis=0, dtype=np.float64)])  # (T + 1, K)

    def lengths(self) -> list[int]:
        return [self.length(run) for run in range(len(self._skill))]

    def length(self, run: int) -> int:
        """Timesteps of a run, 0 when it has been joined to another."""
        return self._end[run] - self._starts[run] if self._alive[run] else 0

    def merge(self, run: int) -> int:
        """Gives a run to the neighbour that fits it better, and returns the name of what they have become."""
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


def _spans(labels: Labels, confidence: npt.NDArray[np.float32]) -> tuple[Span, ...]:
    starts = run_starts(labels).tolist()
    ends = [*starts[1:], len(labels)]
    return tuple(
        Span(start, end, int(labels[start]), float(confidence[start:end].mean()))
        for start, end in zip(starts, ends, strict=True)
    )
