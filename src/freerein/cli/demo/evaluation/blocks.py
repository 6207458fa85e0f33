"""Layout of the true states of `blocks`.

A state is float64 (S,): the gripper's y, z and opening in metres, then x, y, z and a quaternion of each block.
"""

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

States: TypeAlias = npt.NDArray[np.float64]

COLOURS = ("red", "green", "yellow", "blue")
"""Block colours, in the order of the state."""

SIDE_M = 0.05
"""Edge length of a block in metres."""

_GRIPPER, _POSE = 3, 7


def gripper_positions(states: States) -> States:
    """Returns y and z of the gripper in metres, float64 (..., 2), for states (..., S)."""
    return states[..., :2]


def block_positions(states: States) -> States:
    """Returns x, y and z of the blocks' centres in metres, float64 (..., blocks, 3), for states (..., S)."""
    return states[..., _GRIPPER:].reshape(*states.shape[:-1], -1, _POSE)[..., :3]
