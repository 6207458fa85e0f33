"""Where the player can walk: the floor between walls, in map units."""

from functools import partial

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.walkable_grid import Places, WalkableGrid

CELL_UNITS = 8
CLEAR_UNITS = 20.0
"""Least distance of the player's middle from a wall; half its width is 16."""

AHEAD_UNITS = 48.0
"""How far ahead on its way a walker looks."""

_ROOMY_UNITS = 48.0


def floor_between(walls: npt.NDArray[np.float64]) -> WalkableGrid:
    """Returns the floor between walls, float64 (L, 2, 2): both ends of each."""
    low, high = walls.min(axis=(0, 1)), walls.max(axis=(0, 1))
    clearance = partial(_distance, walls)
    return WalkableGrid(clearance, low, high, cell=CELL_UNITS, clear=CLEAR_UNITS, roomy=_ROOMY_UNITS)


def _distance(walls: npt.NDArray[np.float64], places: Places) -> npt.NDArray[np.float64]:
    """Returns the distance of places to the nearest wall, float64 (N,)."""
    nearest = np.full(len(places), np.inf)
    for begin, end in walls:
        along = end - begin
        share = np.clip((places - begin) @ along / (along @ along), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(begin + share[:, None] * along - places, axis=1))
    return nearest
