"""Decodes skill probabilities as they arrive, into the labels and segments of the whole trajectory."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from freerein.metrics import run_starts
from freerein.types.segmentation import NO_SKILL, Segment
from freerein_segmentation.core.decoding import Labels, reject_uncertain, smooth, smoothing_reach
from freerein_segmentation.model import Prediction

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Timeline:
    """Labels of consecutive timesteps.

    Attributes:
        labels: int64 (n,), skill index of each, or `NO_SKILL`.
        confidence: float32 (n,), smoothed probability of that skill; of the rejected one, where it was.
        in_distribution: float32 (n,).
    """

    labels: Labels
    confidence: Floats
    in_distribution: Floats

    def __len__(self) -> int:
        return len(self.labels)

    def __getitem__(self, at: slice) -> "Timeline":
        return Timeline(self.labels[at], self.confidence[at], self.in_distribution[at])

    def __add__(self, other: "Timeline") -> "Timeline":
        return Timeline(
            np.concatenate([self.labels, other.labels]),
            np.concatenate([self.confidence, other.confidence]),
            np.concatenate([self.in_distribution, other.in_distribution]),
        )


@dataclass(frozen=True, eq=False)
class Finished:
    """Labels that became final.

    Attributes:
        start: First timestep.
        timeline: Its labels and those after it.
        segments: Segments that ended.
    """

    start: int
    timeline: Timeline
    segments: tuple[Segment, ...]


class StreamDecoder:
    """Decodes one trajectory as `decode` does, without merging; memory does not grow with time.

    Args:
        skills: The skills.
        smoothing: As of `SegmentRequest`.
        min_confidence: As of `SegmentRequest`.
        min_kept: As of `SegmentRequest`.
    """

    def __init__(self, *, skills: Sequence[str], smoothing: float, min_confidence: float, min_kept: int) -> None:
        self.lag = smoothing_reach(smoothing) + max(0, min_kept - 1)
        self._smoother = _Smoother(len(skills), sigma=smoothing, min_confidence=min_confidence)
        self._runs = _OpenRuns(skills, min_kept=min_kept)

    def push(self, prediction: Prediction) -> Finished:
        """Returns what the next timesteps make final."""
        return self._runs.push(self._smoother.push(prediction))

    def finish(self, prediction: Prediction) -> Finished:
        """Returns the remaining labels, with the last timesteps of the trajectory."""
        first = self._runs.push(self._smoother.push(prediction))
        last = self._runs.push(self._smoother.rest(), is_last=True)
        return replace(first, timeline=first.timeline + last.timeline, segments=first.segments + last.segments)

    def provisional(self, prediction: Prediction) -> Labels:
        """Returns labels of the timesteps that are not final, were these the last ones; changes nothing."""
        return np.concatenate([self._runs.held.labels, self._smoother.rest(prediction).labels])


class _Smoother:
    """Smooths probabilities that arrive bit by bit, and rejects uncertain timesteps."""

    def __init__(self, skills: int, *, sigma: float, min_confidence: float) -> None:
        self._sigma = sigma
        self._min_confidence = min_confidence
        self._reach = smoothing_reach(sigma)
        self._past = 0  # rows of the window that are smoothed, and only needed by later ones
        self._window = Prediction(np.empty((0, skills), np.float32), np.empty(0, np.float32))

    def push(self, prediction: Prediction) -> Timeline:
        """Returns the timesteps that are smooth once these have arrived."""
        self._window = _joined(self._window, prediction)
        stop = max(self._past, len(self._window.in_distribution) - self._reach)
        smoothed = self._smoothed(self._window, stop)
        dropped = max(0, stop - self._reach)
        self._window = Prediction(self._window.probabilities[dropped:], self._window.in_distribution[dropped:])
        self._past = stop - dropped
        return smoothed

    def rest(self, prediction: Prediction | None = None) -> Timeline:
        """Returns the timesteps that are left if the trajectory ends here, or with these; changes nothing."""
        window = _joined(self._window, prediction) if prediction else self._window
        return self._smoothed(window, len(window.in_distribution))

    def _smoothed(self, window: Prediction, stop: int) -> Timeline:
        at = slice(self._past, stop)
        likely = smooth(window.probabilities, sigma=self._sigma)[at]
        confidence = likely.max(axis=1, initial=0.0).clip(max=1.0)  # rounding
        labels = reject_uncertain(
            likely.argmax(axis=1).astype(np.int64), confidence, min_confidence=self._min_confidence
        )
        return Timeline(labels, confidence, window.in_distribution[at])


@dataclass(frozen=True)
class _OpenRun:
    """A run that is long enough to be kept, and has not ended."""

    start: int
    skill: int
    confidence: float  # summed


class _OpenRuns:
    """Rejects runs that are shorter than `min_kept`; holds the last one until it is long enough.

    Attributes:
        held: Timesteps that are not final: the start of a run.
    """

    def __init__(self, skills: Sequence[str], *, min_kept: int) -> None:
        self.held = Timeline(np.empty(0, np.int64), np.empty(0, np.float32), np.empty(0, np.float32))
        self._skills = skills
        self._min_kept = min_kept
        self._start = 0  # timestep of the first one held, or of the next
        self._open: _OpenRun | None = None

    def push(self, timeline: Timeline, *, is_last: bool = False) -> Finished:
        """Returns what the next timesteps make final."""
        given, begin, segments = self.held + timeline, self._start, list[Segment]()
        labels, final = given.labels.copy(), 0
        for start, stop in pairwise([*run_starts(given.labels).tolist(), len(given)]):
            skill, confidence = int(given.labels[start]), float(given.confidence[start:stop].sum(dtype=np.float64))
            if self._open is not None and self._open.skill == skill:
                self._open = replace(self._open, confidence=self._open.confidence + confidence)
            else:
                segments += self._closed(begin + start)
                if skill != NO_SKILL and stop - start >= self._min_kept:
                    self._open = _OpenRun(begin + start, skill, confidence)
                elif skill == NO_SKILL or is_last or stop < len(given):
                    labels[start:stop] = NO_SKILL
                else:
                    break
            final = stop
        self._start, self.held = begin + final, given[final:]
        if is_last:
            segments += self._closed(self._start)
        return Finished(begin, replace(given[:final], labels=labels[:final]), tuple(segments))

    def _closed(self, end: int) -> list[Segment]:
        """Ends the open run, if there is one, and returns it as a segment."""
        if (run := self._open) is None:
            return []
        self._open = None
        return [Segment(run.start, end, self._skills[run.skill], run.confidence / (end - run.start))]


def _joined(first: Prediction, second: Prediction) -> Prediction:
    return Prediction(
        np.concatenate([first.probabilities, second.probabilities]),
        np.concatenate([first.in_distribution, second.in_distribution]),
    )
