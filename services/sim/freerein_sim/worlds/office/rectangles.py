"""Geometry of rectangles on the floor, float64 (R, 4): least x, least y, greatest x, greatest y."""

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.walkable_grid import Places

Rectangles = npt.NDArray[np.float64]


def distance(rectangles: Rectangles, places: Places) -> npt.NDArray[np.float64]:
    """Returns the distance of places (N, 2) to the nearest rectangle, 0 within one: float64 (N,)."""
    outside = np.maximum(rectangles[:, :2] - places[:, None], places[:, None] - rectangles[:, 2:])  # (N, R, 2)
    return np.asarray(np.linalg.norm(np.maximum(outside, 0), axis=-1).min(axis=1))


def is_visible(rectangles: Rectangles, viewpoint: Places, places: Places) -> npt.NDArray[np.bool_]:
    """Returns whether no rectangle is between a viewpoint, float64 (2,), and each of the places (N, 2): bool (N,)."""
    along = places - viewpoint
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)[:, None]  # (N, 1, 2)
    first, second = (rectangles[:, :2] - viewpoint) / along, (rectangles[:, 2:] - viewpoint) / along  # (N, R, 2)
    entered, left = np.minimum(first, second).max(axis=-1), np.maximum(first, second).min(axis=-1)
    is_hidden = ((entered <= np.minimum(left, 1)) & (left >= 0)).any(axis=1)
    return np.asarray(~is_hidden)
