"""Claims: figures with intervals, baselines and ceilings, as they stand in `table.json`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

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
        world_version: Name and version of the world that its results were made in.
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
    world_version: str
    command: str
    minutes: float


def mean(samples: Sequence[Sample]) -> float:
    """Returns the mean over seeds."""
    return float(np.mean([sample.mean for sample in samples]))


def interval(samples: Sequence[Sample], *, rng: np.random.Generator) -> tuple[float, float]:
    """Returns the 95 % interval of the mean over seeds: percentile bootstrap over seeds and over trials.

    All seeds have the same resampled trials, for they are evaluated on the same ones: more seeds do not make up for few
    trials. With one seed it is over its trials, and says nothing about other seeds.
    """
    (means,) = _resampled_means([samples], rng)
    return _middle(means)


def ratio_interval(
    samples: Sequence[Sample], others: Sequence[Sample], *, rng: np.random.Generator
) -> tuple[float, float]:
    """Returns the 95 % interval of the ratio of two means over seeds, which are resampled apart, as in `interval`."""
    means, other_means = _resampled_means([samples, others], rng)
    return _middle(means / other_means)


def difference_interval(
    samples: Sequence[Sample], others: Sequence[Sample], *, rng: np.random.Generator
) -> tuple[float, float]:
    """Returns the 95 % interval of the difference of two means over seeds, as `ratio_interval`."""
    means, other_means = _resampled_means([samples, others], rng)
    return _middle(means - other_means)


def gap_closed(value: float, *, baseline: float | None, ceiling: float | None, least_gap: float) -> float | None:
    """Returns the share of the gap between baseline and ceiling that a value closes.

    None without a gap of at least `least_gap`: the share of a smaller one is noise.
    """
    if baseline is None or ceiling is None or ceiling - baseline < least_gap:
        return None
    return (value - baseline) / (ceiling - baseline)


def _resampled_means(groups: Sequence[Sequence[Sample]], rng: np.random.Generator) -> list[npt.NDArray[np.float64]]:
    """Returns the means over resampled seeds of the figure over resampled trials, float64 (resamples,), of each group.

    Samples of as many trials have the same resampled trials.
    """
    lengths = sorted({len(sample.totals) for samples in groups for sample in samples})
    trials = {length: rng.integers(length, size=(_RESAMPLES, length)) for length in lengths}
    means = []
    for samples in groups:
        ratios = np.stack([_ratios(sample, trials[len(sample.totals)]) for sample in samples], axis=1)  # (R, seeds)
        seeds = rng.integers(len(samples), size=ratios.shape)
        means.append(np.take_along_axis(ratios, seeds, axis=1).mean(axis=1))
    return means


def _ratios(sample: Sample, trials: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Returns a sample's figure over each choice of trials, of int64 (R, trials): float64 (R,)."""
    totals, counts = np.array(sample.totals, np.float64), np.array(sample.counts, np.float64)
    ratios: npt.NDArray[np.float64] = totals[trials].sum(axis=1) / counts[trials].sum(axis=1)
    return ratios


def _middle(values: npt.NDArray[np.float64]) -> tuple[float, float]:
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)
