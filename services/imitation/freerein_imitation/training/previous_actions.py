"""The action executed before each timestep, an input of recurrent policies."""

from typing import Any

import numpy as np
import numpy.typing as npt


def previous_actions(actions: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Returns the action before each of `actions`, float32 (T, A) or int64 (T, 1); 0, or -1 when discrete, at first."""
    none = np.full_like(actions[:1], -1 if np.issubdtype(actions.dtype, np.integer) else 0)
    return np.concatenate([none, actions[:-1]])
