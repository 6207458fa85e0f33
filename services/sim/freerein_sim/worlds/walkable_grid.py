"""Shortest ways of a walker among obstacles, on a grid of the places that are clear of them."""

import heapq
import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Places = npt.NDArray[np.float64]
"""float64 (N, 2): x and y."""

_NARROW_COST = 2.0
"""Factor by which a way along an obstacle costs more than one that is `roomy` away from all."""

_STEPS = tuple((dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx)
_SMOOTHED = 9


class WalkableGrid:
    """Free places between two corners, whose rims are obstacles.

    Args:
        clearance: Returns the distance of places (N, 2) to the nearest obstacle, float64 (N,).
        low: float64 (2,), the corner of least x and y.
        high: float64 (2,), the other.
        cell: Distance of neighbouring places.
        clear: Least clearance of a place where the walker's middle may be.
        roomy: Clearance from which a way costs its length alone.
    """

    def __init__(
        self,
        clearance: Callable[[Places], npt.NDArray[np.float64]],
        low: npt.NDArray[np.float64],
        high: npt.NDArray[np.float64],
        *,
        cell: float,
        clear: float,
        roomy: float,
    ) -> None:
        self.clearance, self._origin = clearance, low
        self._cell, self._clear, self._roomy = cell, clear, roomy
        columns, rows = np.ceil((high - low) / cell).astype(int) + 1
        places = low + cell * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
        self._clearance = clearance(places.reshape(-1, 2)).reshape(rows, columns)
        self._next_cells = lru_cache(maxsize=32)(self._compute_next_cells)

    @property
    def free_places(self) -> Places:
        """Places of the grid that are clear of obstacles."""
        rows, columns = np.nonzero(self._clearance >= self._clear)
        return np.asarray(self._origin + self._cell * np.stack([columns, rows], axis=1))

    def way(self, begin: Places, end: Places) -> Places:
        """Returns a short way that keeps away from obstacles where it can: places about a cell apart.

        Args:
            begin: float64 (2,), the first place.
            end: float64 (2,), the last place.
        """
        cell, last = self._nearest_cell(begin), self._nearest_cell(end)
        next_cells, cells = self._next_cells(last), [cell]
        while cell != last:
            cell = next_cells[cell]
            cells.append(cell)
        inner = self._origin + self._cell * np.array(cells)[:, ::-1]
        return np.concatenate([[begin], inner[1:-1], [end]])

    def strayed(self, way: Places, rng: np.random.Generator, *, by: float, every: float) -> Places:
        """Returns a way moved to its sides, where there is room; its ends stay.

        Args:
            way: A way.
            rng: Draws how far.
            by: Standard deviation of how far.
            every: Length of the way after which that is drawn anew.
        """
        count, spacing = len(way), every / self._cell
        knots = np.arange(0, count + spacing, spacing)
        aside = np.interp(np.arange(count), knots, rng.normal(0, by, len(knots)))
        aside[[0, -1]] = 0
        along = np.gradient(way, axis=0) if count > 1 else np.zeros_like(way)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        return self.kept_clear(way + aside[:, None] * normal, way)

    def kept_clear(self, changed: Places, way: Places) -> Places:
        """Returns a changed way, with the places of the way itself where the change comes too close to obstacles."""
        return np.where((self.clearance(changed) >= self._clear)[:, None], changed, way)

    def _nearest_cell(self, place: Places) -> tuple[int, int]:
        """Returns row and column of the cell nearest to a place that is clear of obstacles."""
        nearest = int(np.argmin(np.linalg.norm(self.free_places - place, axis=1)))
        row, column = np.argwhere(self._clearance >= self._clear)[nearest]
        return int(row), int(column)

    def _compute_next_cells(self, last: tuple[int, int]) -> dict[tuple[int, int], tuple[int, int]]:
        """Returns the next cell on the way to `last` from each cell from which there is one (Dijkstra)."""
        next_cells: dict[tuple[int, int], tuple[int, int]] = {last: last}
        costs, queue = {last: 0.0}, [(0.0, last)]
        while queue:
            cost, cell = heapq.heappop(queue)
            if cost > costs[cell]:
                continue
            for step in _STEPS:
                other = cell[0] + step[0], cell[1] + step[1]
                if self._clearance[other] < self._clear:  # cells at the rim are obstacles
                    continue
                total = cost + math.hypot(*step) * self._cost(other)
                if total < costs.get(other, math.inf):
                    costs[other], next_cells[other] = total, cell
                    heapq.heappush(queue, (total, other))
        return next_cells

    def _cost(self, cell: tuple[int, int]) -> float:
        crowded = max(0.0, 1 - float(self._clearance[cell]) / self._roomy)
        return 1 + (_NARROW_COST - 1) * crowded


def smoothed(way: Places) -> Places:
    """Returns moving averages of nine places of a way; its ends stay."""
    margin = _SMOOTHED // 2
    padded = np.concatenate([np.repeat(way[:1], margin, axis=0), way, np.repeat(way[-1:], margin, axis=0)])
    kernel = np.ones(_SMOOTHED) / _SMOOTHED
    return np.stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in range(2)], axis=1)
