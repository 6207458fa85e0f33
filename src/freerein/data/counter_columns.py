"""Numbers of actions that are counters or clocks, such as the index that a table was written with."""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

_FEWEST_COUNTS, _FEWEST_RISES = 2, 4
"""Steps of a column, over all trajectories, from which it is a counter, or a clock: fewer may be chance."""

_EPOCH = 1e8
"""Below any time since the epoch, and above what robots do."""


class CounterColumns:
    """Finds the numbers of an action that count, or only grow, in every trajectory; their names may be empty."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._counts: npt.NDArray[np.bool_] | None = None
        self._grows: npt.NDArray[np.bool_] | None = None
        self._steps = 0

    def add(self, actions: npt.NDArray[np.float32] | npt.NDArray[np.int64]) -> None:
        """Takes the actions of a trajectory, (T, A)."""
        is_number = np.issubdtype(actions.dtype, np.floating) and np.isfinite(actions).all()
        if len(actions) < 2 or not is_number:
            return
        rises = np.diff(actions.astype(np.float64), axis=0)
        counts = np.all(np.isclose(rises, 1, atol=1e-6), axis=0)
        is_epoch = np.all(np.abs(actions) > _EPOCH, axis=0)  # float32 has no seconds there
        grows = np.all(rises >= 0, axis=0) & (is_epoch | (np.mean(rises > 0, axis=0) > 0.5))
        self._counts = counts if self._counts is None else self._counts & counts
        self._grows = grows if self._grows is None else self._grows & grows
        self._steps += len(rises)

    def sentences(self) -> Iterator[str]:
        """Yields a warning for each such number."""
        if self._counts is None or self._grows is None:
            return
        for place, (counts, grows) in enumerate(zip(self._counts, self._grows, strict=True)):
            name = f"`{self._names[place]}`" if self._names else f"number {place + 1}"
            if (counts and self._steps >= _FEWEST_COUNTS) or (grows and self._steps >= _FEWEST_RISES):
                kind = "counts up by one" if counts else "only grows"
                yield f"Actions must not hold counters or clocks; {name} of them {kind} in every trajectory."
