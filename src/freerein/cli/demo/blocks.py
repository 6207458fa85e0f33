"""The true states of `blocks`, as evaluation reads them; no learner comes near them.

A state is float64 (S,): the gripper's y, z and opening in metres, then x, y, z and a quaternion of each block.
"""

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

States: TypeAlias = npt.NDArray[np.float64]

COLOURS = ("red", "green", "yellow", "blue")
"""Of the blocks, in the order in which a state holds them."""

SIDE_M = 0.05
"""Of a block."""

_GRIPPER, _POSE = 3, 7


def grippers(states: States) -> States:
    """Returns where the gripper is, float64 (..., 2), y and z in metres, in states (..., S)."""
    return states[..., :2]


def places(states: States) -> States:
    """Returns where the blocks' centres are, float64 (..., blocks, 3), x, y and z in metres, in states (..., S)."""
    return states[..., _GRIPPER:].reshape(*states.shape[:-1], -1, _POSE)[..., :3]
