"""Claims: figures with intervals, baselines and ceilings, as they stand in `table.json`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from experiments.workbench.results import Sample

Scale = Literal["full", "reduced"]
"""`full` for the dissertation's amount of training data, else `reduced`, which supports no claim."""

_RESAMPLES = 2000


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One figure, and what it is compared with; None where a field means nothing.

    Attributes:
        claim: Name of the claim.
        value: Mean over seeds.
        low: Lower end of the 95 % interval; see `interval`.
        high: Its upper end.
        seeds: Number of independently trained networks; None for a guess.
        trials: Number of trials of each network, or of the guess: trajectories or episodes.
        scale: Whether the training data are as many as the dissertation's; None where it has no such figure.
        baseline: Value of the dissertation's method here, or of what else the experiment compares with.
        ceiling: Value with full supervision, or of the scripted expert.
        gap_closed: (value - baseline) / (ceiling - baseline); None where the gap is small.
        dissertation: The dissertation's figure.
        target: Least value that the claim needs, or the largest where smaller is better; the experiment says which.
        met: Whether it is reached, and what the claim needs besides.
        world_hash: Hash of what the world's generator drew.
        command: The command that makes the results.
        minutes: Wall-clock time of all seeds.
    """

    claim: str
    value: float
    low: float | None
    high: float | None
    seeds: int | None
    trials: int
    scale: Scale | None
    baseline: float | None
    ceiling: float | None
    gap_closed: float | None
    dissertation: float | None
    target: float | None
    met: bool | None
    world_hash: str
    command: str
    minutes: float


def mean(samples: Sequence[Sample]) -> float:
    """Returns the mean over seeds."""
    return float(np.mean([sample.mean for sample in samples]))


def interval(samples: Sequence[Sample], *, rng: np.random.Generator) -> tuple[float, float]:
    """Returns the 95 % interval of the mean over seeds: percentile bootstrap over seeds, then over trials of each.

    With one seed it is over its trials, and says nothing about other seeds.
    """
    from scipy import stats  # half a second, which processes of arms do without

    arrays = [np.array([sample.totals, sample.counts], np.float64) for sample in samples]  # (2, trials) each

    def resampled_mean(seeds: npt.NDArray[np.int64]) -> float:
        return float(np.mean([_resampled_ratio(arrays[seed], rng) for seed in seeds]))

    options: dict[str, Any] = {"n_resamples": _RESAMPLES, "method": "percentile", "rng": rng}
    if len(arrays) > 1:
        found = stats.bootstrap((np.arange(len(arrays)),), resampled_mean, vectorized=False, **options)
    else:
        found = stats.bootstrap(arrays[0], _ratio, paired=True, **options)
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def ratio_interval(
    samples: Sequence[Sample], others: Sequence[Sample], *, rng: np.random.Generator
) -> tuple[float, float]:
    """Returns the 95 % interval of the ratio of two means over seeds, which are resampled apart, as in `interval`."""
    ratios = [_resampled(samples, rng) / _resampled(others, rng) for _ in range(_RESAMPLES)]
    low, high = np.percentile(ratios, [2.5, 97.5])
    return float(low), float(high)


def gap_closed(value: float, *, baseline: float | None, ceiling: float | None, least_gap: float) -> float | None:
    """Returns the share of the gap between baseline and ceiling that a value closes.

    None without a gap of at least `least_gap`: the share of a smaller one is noise.
    """
    if baseline is None or ceiling is None or ceiling - baseline < least_gap:
        return None
    return (value - baseline) / (ceiling - baseline)


def _resampled(samples: Sequence[Sample], rng: np.random.Generator) -> float:
    """Returns the mean over resampled seeds of the figure over resampled trials."""
    chosen = [
        np.array([each.totals, each.counts], np.float64)
        for each in [samples[i] for i in rng.integers(len(samples), size=len(samples))]
    ]
    return float(np.mean([_resampled_ratio(each, rng) for each in chosen]))


def _resampled_ratio(sample: npt.NDArray[np.float64], rng: np.random.Generator) -> Any:
    """Returns the ratio over resampled trials of a sample (2, trials): totals and counts."""
    trials = rng.integers(sample.shape[1], size=sample.shape[1])  # as rng.choice draws them, sooner
    totals, counts = np.take(sample, trials, axis=1)
    return _ratio(totals, counts)


def _ratio(totals: npt.NDArray[np.float64], counts: npt.NDArray[np.float64], axis: int = -1) -> Any:
    return totals.sum(axis=axis) / counts.sum(axis=axis)
