"""Means and medians over episodes that follow a few demonstrations, with intervals over all that was drawn."""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from experiments.workbench.results import Sample

Episodes = npt.NDArray[np.float64]
"""Of every seed, demonstration and start, float64 (..., seeds, demonstrations, starts)."""

Values = npt.NDArray[np.float64]
Statistic = Callable[[Episodes], Values]
"""Returns a value of each (...,)."""

_RESAMPLES, _SEED = 2000, 0


def by_demonstration(samples: Sequence[Sample], *, demonstrations: int) -> Episodes:
    """Returns the figure of each trial of each seed; trial i follows the demonstration of number i modulo theirs."""
    figures = np.array([np.divide(each.totals, each.counts) for each in samples], np.float64)
    return figures.reshape(len(samples), -1, demonstrations).swapaxes(1, 2)


def median(episodes: Episodes) -> Values:
    """Returns the mean over seeds of the median over episodes."""
    return np.asarray(np.median(episodes, axis=(-2, -1)).mean(axis=-1))


def mean(episodes: Episodes) -> Values:
    """Returns the mean over seeds and episodes."""
    return np.asarray(episodes.mean(axis=(-3, -2, -1)))


def interval(episodes: Episodes, statistic: Statistic) -> tuple[float, float]:
    """Returns the 95 % interval of a statistic: percentile bootstrap over seeds, demonstrations and starts.

    All seeds have the same resampled demonstrations, and starts of each. With one seed, or one demonstration, it says
    nothing about others.
    """
    low, high = np.percentile(statistic(_resample(episodes)), [2.5, 97.5])
    return float(low), float(high)


def gain_interval(rows: Episodes, statistic: Statistic) -> tuple[float, float]:
    """Returns the 95 % interval of how much the first of two rows, (2, ...), is above the other, resampled together."""
    own, other = statistic(_resample(rows))
    low, high = np.percentile(own - other, [2.5, 97.5])
    return float(low), float(high)


def _resample(episodes: Episodes) -> Episodes:
    """Returns resampled episodes, (..., resamples, seeds, demonstrations, starts)."""
    rng, (seeds, demonstrations, starts) = np.random.default_rng(_SEED), episodes.shape[-3:]
    seed = rng.integers(seeds, size=(_RESAMPLES, seeds, 1, 1))
    shown = rng.integers(demonstrations, size=(_RESAMPLES, 1, demonstrations, 1))
    start = rng.integers(starts, size=(_RESAMPLES, 1, demonstrations, starts))
    return episodes[..., seed, shown, start]
