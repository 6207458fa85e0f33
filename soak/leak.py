"""Whether memory grows with the number of calls."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MOST_MIB_PER_10K_CALLS = 1.0
_FEWEST_SAMPLES = 10


@dataclass(frozen=True)
class Sample:
    """A measurement of a service.

    Attributes:
        calls: Calls that it has completed.
        rss_mib: Memory of its processes.
    """

    calls: float
    rss_mib: float


def growth_mib_per_10k_calls(samples: Sequence[Sample]) -> float:
    """Returns the Theil-Sen slope of memory over calls, without the first third of the samples: the warm-up.

    It is the median of the slopes of all pairs of samples, so that a few peaks do not change it.

    Raises:
        ValueError: There are fewer than 10 samples after the warm-up, or they were all taken at one number of calls.
    """
    from scipy.stats import theilslopes  # takes a second to import, which a soak has and its tests have not

    kept = samples[len(samples) // 3 :]
    calls = np.array([sample.calls for sample in kept])
    if len(kept) < _FEWEST_SAMPLES or np.ptp(calls) == 0:
        raise ValueError(f"Expected {_FEWEST_SAMPLES} samples at different numbers of calls; got {len(kept)}.")
    return 1e4 * float(theilslopes([sample.rss_mib for sample in kept], calls).slope)
