"""Per-feature statistics in the shapes of LeRobot's `stats.json`, of one trajectory and of many.

A quantile of one trajectory is exact: the least value that at least that share of the values do not exceed. Of many it
is the mean of theirs, weighted by timesteps, as LeRobot combines them.
"""

import numpy as np
import numpy.typing as npt

QUANTILES = {"q01": 1, "q10": 10, "q50": 50, "q90": 90, "q99": 99}
"""LeRobot's, in percent. Trajectories of earlier versions of freerein have none."""

STATISTICS = ("min", "max", "mean", "std", *QUANTILES, "count")

FeatureStatistics = dict[str, npt.NDArray[np.float64]]
"""By name of `STATISTICS`: float64 arrays of one shape; `count` is (1,), the number of timesteps."""


def of_values(values: npt.NDArray[np.generic]) -> FeatureStatistics:
    """Returns the statistics of each column of (T, D) values, T >= 1: arrays of shape (D,)."""
    numbers = values.astype(np.float64)
    return {
        "min": numbers.min(axis=0),
        "max": numbers.max(axis=0),
        "mean": numbers.mean(axis=0),
        "std": numbers.std(axis=0),
        **dict(zip(QUANTILES, np.sort(numbers, axis=0)[_quantile_ranks(len(numbers))], strict=True)),
        "count": np.array([len(numbers)], np.float64),
    }


def of_frames(frames: npt.NDArray[np.uint8]) -> FeatureStatistics:
    """Returns the exact statistics of each channel of (T, H, W, C) frames, scaled to [0, 1]: arrays (C, 1, 1)."""
    channels = [_of_histogram(_histogram(frames[..., channel])) for channel in range(frames.shape[-1])]
    stacked = {name: np.array([one[name] for one in channels]).reshape(-1, 1, 1) for name in STATISTICS[:-1]}
    return {**stacked, "count": np.array([len(frames)], np.float64)}


def combined(parts: FeatureStatistics) -> FeatureStatistics:
    """Combines the statistics of n trajectories, stacked along a leading axis: (n, ...), `count` (n, 1).

    Quantiles may be missing, and then are missing in what is returned.
    """
    total = parts["count"].sum()
    weights = parts["count"].reshape(-1, *(1,) * (parts["mean"].ndim - 1)) / total
    mean = (weights * parts["mean"]).sum(axis=0)
    variance = (weights * (parts["std"] ** 2 + (parts["mean"] - mean) ** 2)).sum(axis=0)
    return {
        "min": parts["min"].min(axis=0),
        "max": parts["max"].max(axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        **{name: (weights * parts[name]).sum(axis=0) for name in QUANTILES if name in parts},
        "count": np.array([total]),
    }


def _quantile_ranks(count: int) -> list[int]:
    """Returns the place of each quantile among `count` sorted values."""
    return [-(-percent * count // 100) - 1 for percent in QUANTILES.values()]


def _histogram(plane: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64]:
    """Counts the 256 values of (T, H, W), frame by frame because bincount copies its input to int64."""
    counts = np.zeros(256, np.int64)
    for frame in plane:
        counts += np.bincount(frame.ravel(), minlength=256)
    return counts


def _of_histogram(histogram: npt.NDArray[np.int64]) -> dict[str, float]:
    levels = np.arange(256) / 255
    present = levels[histogram > 0]
    weights = histogram / histogram.sum()
    mean = float(weights @ levels)
    std = float(np.sqrt(weights @ (levels - mean) ** 2))
    ranks = _quantile_ranks(int(histogram.sum()))
    quantiles = levels[np.searchsorted(np.cumsum(histogram), ranks, side="right")]
    return {
        "min": float(present[0]),
        "max": float(present[-1]),
        "mean": mean,
        "std": std,
        **dict(zip(QUANTILES, map(float, quantiles), strict=True)),
    }
