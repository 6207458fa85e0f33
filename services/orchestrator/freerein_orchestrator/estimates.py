"""A mean and how sure it is."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

_RESAMPLES = 10_000


@dataclass(frozen=True)
class Estimate:
    """The mean of a sample, with the interval that 95 % of the means of its resamples lie in (percentile bootstrap).

    Attributes:
        mean: Of the sample.
        low: The interval's lower end.
        high: Its upper end.
    """

    mean: float
    low: float
    high: float


def estimate(values: npt.ArrayLike, *, rng: np.random.Generator) -> Estimate:
    """Returns the mean of values, one of each episode, and its interval.

    Args:
        values: Numbers (n,), n >= 1.
        rng: Draws the resamples.
    """
    sample = np.asarray(values, np.float64)
    means = [sample[rng.integers(len(sample), size=len(sample))].mean() for _ in range(_RESAMPLES)]
    low, high = np.percentile(means, [2.5, 97.5])
    return Estimate(float(sample.mean()), float(low), float(high))
