"""Movements of the hand as people make them: minimum-jerk from rest to rest, with pauses, in a given number of steps.

A movement is a sequence of stretches. Each takes at least so many steps; what is left of the time is shared out among
them by their weights.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Pose = npt.NDArray[np.float64]
"""float64 (6,): x, y, z in metres, pitch and roll in radians, distance between the fingers in metres; (T, 6) for T."""

Path = Callable[[npt.NDArray[np.float64]], Pose]
"""Returns the poses at shares of its duration from 0 to 1: float64 (T,) to (T, 6)."""

_TURN_M = 0.1
"""A turn by a radian takes as long as a way of this many metres."""

_EXPONENT = 0.7
"""Long ways are made faster: their duration grows as this power of the distance."""

_PACE = (0.7, 1.4)


@dataclass(frozen=True, eq=False)
class _Stretch:
    path: Path
    weight: float
    least: float


class Movement:
    """A movement under construction.

    Args:
        start: Pose that it begins with.
        rng: Draws the pace of each stretch.

    Attributes:
        here: Pose that it ends with so far.
    """

    def __init__(self, start: Pose, rng: np.random.Generator) -> None:
        self.here = start
        self._rng = rng
        self._stretches: list[_Stretch] = []

    def go(self, end: Pose, *, least: float = 0.5) -> None:
        """Adds a straight way from rest to rest."""
        start, change = self.here, end - self.here
        way = float(np.linalg.norm(change[:3]) + _TURN_M * np.abs(change[3:]).sum())
        weight = self._rng.uniform(*_PACE) * way**_EXPONENT
        self.follow(lambda share: start + minimum_jerk(share)[:, None] * change, weight=weight, least=least)

    def rest(self, at_most: float, *, least: float = 0.0) -> None:
        """Adds a pause of a random weight."""
        here = self.here
        self.follow(lambda share: np.tile(here, (len(share), 1)), weight=self._rng.uniform(0, at_most), least=least)

    def follow(self, path: Path, *, weight: float, least: float) -> None:
        """Adds a path, which is followed evenly."""
        self._stretches.append(_Stretch(path, weight, least))
        self.here = path(np.ones(1))[0]

    def poses(self, steps: int) -> Pose:
        """Returns the poses after each of so many steps, float64 (steps, 6); the last is the end."""
        weights, least = (np.array([getattr(each, name) for each in self._stretches]) for name in ("weight", "least"))
        least *= min(1.0, steps / max(least.sum(), 1.0))
        durations = least + (steps - least.sum()) * weights / weights.sum()
        ends, times = np.cumsum(durations), np.arange(1.0, steps + 1)
        poses = np.tile(self.here, (steps, 1))
        for stretch, end, duration in zip(self._stretches, ends, durations, strict=True):
            inside = (times > end - duration) & (times <= end)
            poses[inside] = stretch.path((times[inside] - (end - duration)) / duration)
        return poses


def minimum_jerk(share: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns the share of a way that is made in a share of the time, from rest to rest."""
    return share**3 * (10 - 15 * share + 6 * share**2)
