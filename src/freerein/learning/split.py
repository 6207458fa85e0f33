"""The train/validation split of a dataset."""

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput


def train_validation_split(
    items: npt.ArrayLike,
    *,
    fraction: float,
    seed: int,
    unit: str = "trajectories",
    hint: str = "Record more: freerein sim demonstrate TASK --out NAME.",
) -> tuple[list[int], list[int]]:
    """Returns the training and the validation part of `items`, int (n,), each sorted and not empty.

    `fraction` is that of the validation part, in [0, 1]; `unit` and `hint` are for the error.

    Raises:
        InvalidInput: There are fewer than 2 items.
    """
    order = np.random.default_rng(seed).permutation(np.asarray(items, np.int64)).tolist()
    if len(order) < 2:
        raise InvalidInput(
            f"A fit needs at least 2 {unit}, one of them for validation; got {len(order)}.", field="dataset", hint=hint
        )
    count = min(max(1, round(fraction * len(order))), len(order) - 1)
    return sorted(order[count:]), sorted(order[:count])
