"""Spatial relations of phrases that were located in images."""

import numpy as np
import numpy.typing as npt

from freerein.relations import classify_relation

NO_CAPTION = -1
"""Instead of a relation: no caption mentions this pair, because it is not sure that the image shows both."""


def pairwise_relations(
    x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], is_shown: npt.NDArray[np.bool_], *, epsilon: float
) -> npt.NDArray[np.int8]:
    """Returns the relation of each ordered pair by table 4.1, int8 (N, P, P), `NO_CAPTION` where one is not shown.

    Positions (N, P), x to the right, y down, have the unit of `epsilon`, the object width; `is_shown` is bool (N, P).
    """
    positions = np.stack([x, y], axis=-1)  # (N, P, 2)
    relations = classify_relation(positions[:, :, None], positions[:, None], epsilon=epsilon)  # (N, P, P)
    both = is_shown[:, :, None] & is_shown[:, None] & ~np.eye(x.shape[1], dtype=bool)
    return np.where(both, relations, NO_CAPTION).astype(np.int8)
