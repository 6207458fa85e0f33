"""Initial states of the bins world: groceries upright in the left bin, and the gripper above them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.bins.layout import FLOOR_M, GROCERIES, LEFT_BIN_HALF_M, LEFT_BIN_M, Place

_MARGIN_M = np.array([0.075, 0.065])
_APART_M = np.array([0.115, 0.115])
"""Groceries are at least this far apart along x or along y, so that the gripper fits between."""

_YAW_RAD = 0.35
_GRIPPER_M = ((-0.03, 0.22), (-0.35, 0.25), (1.02, 1.12))
_ABOVE_FLOOR_M = 0.0005


@dataclass(frozen=True, eq=False)
class InitialState:
    """Where an episode begins.

    Attributes:
        gripper: Place of the gripper, float64 (3,).
        poses: float64 (4, 7): place and quaternion of each grocery.
    """

    gripper: Place
    poses: npt.NDArray[np.float64]


def draw(rng: np.random.Generator) -> InitialState:
    """Draws an initial state."""
    gripper = np.array([rng.uniform(*limits) for limits in _GRIPPER_M])
    places = _draw_places(rng)
    poses = np.zeros((len(GROCERIES), 7))
    for pose, place, grocery in zip(poses, places, GROCERIES, strict=True):
        yaw = grocery.yaw_rad + rng.uniform(-_YAW_RAD, _YAW_RAD)
        pose[:] = (*place, FLOOR_M + grocery.below_m + _ABOVE_FLOOR_M, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
    return InitialState(gripper, poses)


def _draw_places(rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """Draws x and y of each grocery, float64 (4, 2)."""
    half = np.array(LEFT_BIN_HALF_M) - _MARGIN_M
    while True:
        places = np.array(LEFT_BIN_M) + rng.uniform(-half, half, size=(len(GROCERIES), 2))
        apart = (np.abs(places[:, None] - places) >= _APART_M).any(axis=-1)
        if (apart | np.eye(len(GROCERIES), dtype=bool)).all():
            return places
