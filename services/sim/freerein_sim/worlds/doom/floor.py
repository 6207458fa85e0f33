"""Where the player can walk, and shortest ways: a grid of the places that are clear of walls."""

import heapq
import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

CELL_UNITS = 8
CLEAR_UNITS = 20.0
"""Least distance of the player's middle from a wall; half its width is 16."""

AHEAD_UNITS = 48.0
"""How far ahead on its way a walker looks."""

_ROOMY_UNITS = 48.0
_NARROW_COST = 2.0
"""Factor by which a way along a wall costs more than one that is `_ROOMY_UNITS` away from all."""

_STEPS = tuple((dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx)

Places = npt.NDArray[np.float64]
"""float64 (N, 2): x and y in map units."""


class Floor:
    """The floor between walls, float64 (L, 2, 2): both ends of each."""

    def __init__(self, walls: npt.NDArray[np.float64]) -> None:
        self._walls = walls
        self._origin = walls.min(axis=(0, 1))
        columns, rows = np.ceil((walls.max(axis=(0, 1)) - self._origin) / CELL_UNITS).astype(int) + 1
        places = self._origin + CELL_UNITS * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
        self._clearance = self.clearance(places.reshape(-1, 2)).reshape(rows, columns)
        self._next_cells = lru_cache(maxsize=16)(self._compute_next_cells)

    def clearance(self, places: Places) -> npt.NDArray[np.float64]:
        """Returns the distance of places to the nearest wall, float64 (N,)."""
        nearest = np.full(len(places), np.inf)
        for begin, end in self._walls:
            along = end - begin
            share = np.clip((places - begin) @ along / (along @ along), 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(begin + share[:, None] * along - places, axis=1))
        return nearest

    def way(self, begin: Places, end: Places) -> Places:
        """Returns a short way that keeps away from walls where it can: places about `CELL_UNITS` apart.

        Args:
            begin: float64 (2,), the first place.
            end: float64 (2,), the last place.
        """
        cell, last = self._nearest_cell(begin), self._nearest_cell(end)
        next_cells, cells = self._next_cells(last), [cell]
        while cell != last:
            cell = next_cells[cell]
            cells.append(cell)
        inner = self._origin + CELL_UNITS * np.array(cells)[:, ::-1]
        return np.concatenate([[begin], inner[1:-1], [end]])

    def _nearest_cell(self, place: Places) -> tuple[int, int]:
        """Returns row and column of the cell nearest to a place that is clear of walls."""
        rows, columns = np.nonzero(self._clearance >= CLEAR_UNITS)
        centres = self._origin + CELL_UNITS * np.stack([columns, rows], axis=1)
        nearest = int(np.argmin(np.linalg.norm(centres - place, axis=1)))
        return int(rows[nearest]), int(columns[nearest])

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
                if self._clearance[other] < CLEAR_UNITS:  # cells at the rim are walls
                    continue
                total = cost + math.hypot(*step) * self._cost(other)
                if total < costs.get(other, math.inf):
                    costs[other], next_cells[other] = total, cell
                    heapq.heappush(queue, (total, other))
        return next_cells

    def _cost(self, cell: tuple[int, int]) -> float:
        crowded = max(0.0, 1 - float(self._clearance[cell]) / _ROOMY_UNITS)
        return 1 + (_NARROW_COST - 1) * crowded
