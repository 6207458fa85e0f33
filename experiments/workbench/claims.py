"""Claims: figures with intervals, baselines and ceilings, as they stand in `table.json`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from experiments.workbench.results import ArmResult, Sample

Scale = Literal["full", "reduced"]
"""`full` for the dissertation's amount of training data, else `reduced`, which supports no claim."""

_RESAMPLES, _SEED = 2000, 0
"""Of every bootstrap: figures over as many trials are of the same resampled ones."""


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
    scale: Scale | None = None
    baseline: float | None = None
    ceiling: float | None = None
    gap_closed: float | None = None
    dissertation: float | None = None
    target: float | None = None
    met: bool | None = None
    world_version: str
    command: str
    minutes: float


def claim_of(
    name: str, arms: Sequence[ArmResult], samples: Sequence[Sample], *, unit: float = 1, digits: int = 3, **more: Any
) -> Claim:
    """Returns a claim of the samples of arms, times a unit, with its interval; `more` are its other fields."""
    low, high = interval(samples)
    return Claim(
        claim=name,
        value=round(unit * mean(samples), digits),
        low=round(unit * low, digits),
        high=round(unit * high, digits),
        trials=len(samples[0].totals),
        world_version=arms[0].world_version,
        minutes=round(sum(arm.minutes for arm in arms), 2),
        **more,
    )


def mean(samples: Sequence[Sample]) -> float:
    """Returns the mean over seeds."""
    return float(np.mean([sample.mean for sample in samples]))


def interval(samples: Sequence[Sample]) -> tuple[float, float]:
    """Returns the 95 % interval of the mean over seeds: percentile bootstrap over seeds and over trials.

    All seeds have the same resampled trials, for they are evaluated on the same ones: more seeds do not make up for few
    trials. With one seed it is over its trials, and says nothing about other seeds.
    """
    (means,) = _resampled_means([samples])
    return _middle(means)


def ratio_interval(samples: Sequence[Sample], others: Sequence[Sample]) -> tuple[float, float]:
    """Returns the 95 % interval of the ratio of two means over seeds, which are resampled apart, as in `interval`."""
    means, other_means = _resampled_means([samples, others])
    return _middle(means / other_means)


def paired_ratio_interval(samples: Sequence[Sample], others: Sequence[Sample]) -> tuple[float, float]:
    """Returns `ratio_interval` with the same resampled seeds in both, of trainings that a seed begins alike.

    Args:
        samples: Of each seed.
        others: Of the same seeds, in their order.
    """
    means, other_means = _resampled_means([samples, others], pairs_seeds=True)
    return _middle(means / other_means)


def difference_interval(samples: Sequence[Sample], others: Sequence[Sample]) -> tuple[float, float]:
    """Returns the 95 % interval of the difference of two means over seeds, as `ratio_interval`."""
    means, other_means = _resampled_means([samples, others])
    return _middle(means - other_means)


def gap_closed(value: float, *, baseline: float | None, ceiling: float | None, least_gap: float) -> float | None:
    """Returns the share of the gap between baseline and ceiling that a value closes.

    None without a gap of at least `least_gap`: the share of a smaller one is noise.
    """
    if baseline is None or ceiling is None or ceiling - baseline < least_gap:
        return None
    return (value - baseline) / (ceiling - baseline)


def _resampled_means(groups: Sequence[Sequence[Sample]], *, pairs_seeds: bool = False) -> list[npt.NDArray[np.float64]]:
    """Returns the means over resampled seeds of the figure over resampled trials, float64 (resamples,), of each group.

    Samples of as many trials have the same resampled trials; where seeds are paired, all groups have the same seeds.
    """
    drawn, rng = _draw_trials(tuple(sorted({len(sample.totals) for samples in groups for sample in samples})))
    means, state = [], rng.bit_generator.state
    for samples in groups:
        if pairs_seeds:
            rng.bit_generator.state = state
        ratios = np.stack([_ratios(sample, drawn[len(sample.totals)]) for sample in samples], axis=1)  # (R, seeds)
        seeds = rng.integers(len(samples), size=ratios.shape)
        means.append(np.take_along_axis(ratios, seeds, axis=1).mean(axis=1))
    return means


def _draw_trials(lengths: tuple[int, ...]) -> tuple[Mapping[int, npt.NDArray[np.float64]], np.random.Generator]:
    """Returns how often each trial is in each resample, for each number of trials, and the generator after that."""
    drawn, state = _draw_trials_once(lengths)
    rng = np.random.default_rng()
    rng.bit_generator.state = state
    return drawn, rng


@lru_cache(maxsize=8)
def _draw_trials_once(lengths: tuple[int, ...]) -> tuple[Mapping[int, npt.NDArray[np.float64]], Mapping[str, Any]]:
    rng = np.random.default_rng(_SEED)
    drawn = {}
    for length in lengths:
        trials = rng.integers(length, size=(_RESAMPLES, length))
        drawn[length] = np.stack([np.bincount(row, minlength=length) for row in trials]).astype(np.float64)
    return drawn, rng.bit_generator.state


def _ratios(sample: Sample, drawn: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns a sample's figure over each resample of its trials, which are float64 (R, trials): float64 (R,)."""
    sums = drawn @ np.array([sample.totals, sample.counts], np.float64).T  # (R, 2)
    ratios: npt.NDArray[np.float64] = sums[:, 0] / sums[:, 1]
    return ratios


def _middle(values: npt.NDArray[np.float64]) -> tuple[float, float]:
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)
