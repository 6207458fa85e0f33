"""Which trajectories a training learns from, and which are held out to choose the best weights by."""

import numpy as np
import numpy.typing as npt


def train_validation_split(items: npt.ArrayLike, *, fraction: float, seed: int) -> tuple[list[int], list[int]]:
    """Returns the items to learn from and those held out, in order, at least one of each.

    Args:
        items: int (n,), 2 or more.
        fraction: Of the items, to hold out.
        seed: Of the draw.
    """
    order = np.random.default_rng(seed).permutation(np.asarray(items, np.int64)).tolist()
    count = min(max(1, round(fraction * len(order))), len(order) - 1)
    return sorted(order[count:]), sorted(order[:count])
