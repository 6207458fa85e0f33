"""Means and medians over episodes that follow a few demonstrations, with intervals over all that was drawn."""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from experiments.workbench.results import Sample

Episodes = npt.NDArray[np.float64]
"""Of every seed, demonstration and start, float64 (seeds, demonstrations, starts); of two rows (2, ...)."""

Statistic = Callable[[Episodes], float]

_RESAMPLES, _SEED = 2000, 0


def by_demonstration(samples: Sequence[Sample], *, demonstrations: int) -> Episodes:
    """Returns the figure of each trial of each seed; trial i follows the demonstration of number i modulo theirs."""
    figures = np.array([np.divide(each.totals, each.counts) for each in samples], np.float64)
    return figures.reshape(len(samples), -1, demonstrations).swapaxes(1, 2)


def median(episodes: Episodes) -> float:
    """Returns the mean over seeds of the median over episodes."""
    return float(np.median(episodes, axis=(1, 2)).mean())


def mean(episodes: Episodes) -> float:
    """Returns the mean over seeds and episodes."""
    return float(episodes.mean())


def interval(episodes: Episodes, statistic: Statistic) -> tuple[float, float]:
    """Returns the 95 % interval of a statistic: percentile bootstrap over seeds, demonstrations and starts.

    All seeds, and rows, have the same resampled demonstrations, and starts of each. With one seed it says nothing about
    others.
    """
    rng, (seeds, demonstrations, starts) = np.random.default_rng(_SEED), episodes.shape[-3:]
    values = []
    for _ in range(_RESAMPLES):
        seed = rng.integers(seeds, size=(seeds, 1, 1))
        shown, start = (
            rng.integers(demonstrations, size=(demonstrations, 1)),
            rng.integers(starts, size=(demonstrations, starts)),
        )
        values.append(statistic(episodes[..., seed, shown, start]))
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)
