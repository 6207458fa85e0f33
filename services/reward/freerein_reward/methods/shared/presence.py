"""Presence of phrases in an image, judged against the other images of a dataset.

A grounding model has one threshold of heat for all phrases. In a dataset the heat of a phrase mostly forms two groups,
of images that show it and of images that do not; where it does, the groups tell better.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

_GROUPS_SPREAD = 0.2
"""Largest share of the variance that two groups leave. Halves of one normal distribution leave 0.36, of a uniform one
0.25: those are no groups."""

_MIN_STD = 0.05
"""Least standard deviation of a group, and of all images: one that is the same everywhere is no group."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Presence:
    """Which of P phrases N images show.

    Attributes:
        probability: float64 (N, P), that the image shows the phrase.
        half_heat: float64 (P,), peak heat between images that show a phrase and images that do not.
    """

    probability: Array
    half_heat: Array


def presence_in_dataset(heat: Array, presence: Array) -> Presence:
    """Returns what the images show.

    Args:
        heat: float64 (N, P), peak heat of each phrase in each image.
        presence: float64 (N, P), probabilities by the grounding model; kept where the heat forms no two groups.
    """
    columns = [_judge(*each) for each in zip(np.sqrt(heat).T, presence.T, strict=True)]
    probability, half = zip(*columns, strict=True)
    return Presence(np.stack(probability, axis=1), np.square(half))


def alone_in_place(x: Array, y: Array, presence: Array, heat: Array, *, epsilon: float) -> npt.NDArray[np.bool_]:
    """Returns whether no other phrase is present less than an object's width away with more heat, bool (N, P).

    Two objects are not in one place: the weaker of two phrases there may be a part of the other's object.

    Args:
        x: float64 (N, P), to the right, in the unit of `epsilon`, as is `y`.
        y: float64 (N, P), down.
        presence: float64 (N, P), probabilities.
        heat: float64 (N, P).
        epsilon: Object width.
    """
    positions = np.stack([x, y], axis=2)  # (N, P, 2)
    distance = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=3)  # (N, P, P)
    is_stronger = (heat[:, None] > heat[:, :, None]) & (presence[:, None] > 0.5)
    is_alone: npt.NDArray[np.bool_] = ~(is_stronger & (distance < epsilon)).any(axis=2)
    return is_alone


def _judge(values: Array, presence: Array) -> tuple[Array, float]:
    """Returns the probability of being shown, float64 (N,), and the value from which it is more than a half.

    The two groups are those of the threshold that leaves the least variance (Otsu, 1979); each is taken to be normal.
    Without groups the phrase is shown, or not, in all images alike: half of what is typical is then too little.
    """
    ordered = np.sort(values)
    sizes = np.arange(1, len(ordered))
    sums, squares = ordered.cumsum(), np.square(ordered).cumsum()
    below = squares[:-1] - sums[:-1] ** 2 / sizes
    above = squares[-1] - squares[:-1] - (sums[-1] - sums[:-1]) ** 2 / sizes[::-1]
    spread = below + above  # (N - 1,), sum of squares within the groups
    if values.std() < _MIN_STD or spread.min() > _GROUPS_SPREAD * len(values) * values.var():
        return presence, _half_of_typical(values)
    at = int(spread.argmin()) + 1
    low, high = ordered[:at], ordered[at:]
    if high.mean() < 1.0:  # where the grounding model says 1/2
        return presence, _half_of_typical(values)
    odds = np.log(len(high) / len(low)) + _log_density(values, high) - _log_density(values, low)
    odds = np.where(values >= high.mean(), np.inf, np.where(values <= low.mean(), -np.inf, odds))
    return 1 / (1 + np.exp(-odds.clip(-50, 50))), float(low[-1] + high[0]) / 2


def _half_of_typical(values: Array) -> float:
    """Returns the root of half of the median heat, or of the heat where the grounding model says 1/2."""
    return max(1.0, float(np.median(values)) / math.sqrt(2))


def _log_density(values: Array, group: Array) -> Array:
    """Returns the logarithm of a group's normal density at values (N,), but for a constant."""
    std = max(float(group.std()), _MIN_STD)
    log_density: Array = -np.log(std) - ((values - group.mean()) / std) ** 2 / 2
    return log_density
