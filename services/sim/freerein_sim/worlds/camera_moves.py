"""Cameras moved or turned a little, in directions drawn for each episode. MuJoCo's model, which worlds share, stays."""

import math
from collections.abc import Collection
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.conditions import CAMERA_SHIFT_M, CAMERA_SHIFTED, CAMERA_TURN_DEG, CAMERA_TURNED
from freerein_sim.worlds.world import foreign_snapshot

_UNIT_TOLERANCE = 1e-6

Directions = npt.NDArray[np.float64]
"""float64 (C, 3): a unit vector for each camera, in its own axes: right, up, backward."""


@dataclass
class CameraMove:
    """Moves each camera by `shift_m` across its view axis, or turns it by `turn_rad` about any axis.

    Attributes:
        directions: Of the current episode.
    """

    cameras: int
    shift_m: float = 0.0
    turn_rad: float = 0.0

    def __post_init__(self) -> None:
        self.directions: Directions = np.tile([1.0, 0.0, 0.0], (self.cameras, 1))

    def draw(self, rng: np.random.Generator) -> None:
        """Draws the directions of an episode: of a shift at right angles to the view axis, of a turn's axis any."""
        drawn = rng.standard_normal((self.cameras, 3))
        if self.shift_m:
            drawn[:, 2] = 0
        self.directions = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)

    def restore(self, directions: npt.NDArray[np.float64]) -> None:
        """Sets the directions of a snapshot, as a flat array. Raises InvalidInput where they are no unit vectors."""
        restored = directions.reshape(self.cameras, 3)
        if (np.abs(np.linalg.norm(restored, axis=1) - 1) > _UNIT_TOLERANCE).any():
            raise foreign_snapshot()
        self.directions = restored.copy()

    def apply(self, data: mujoco.MjData) -> None:
        """Moves the cameras of a state whose camera poses are those of the model."""
        matrix, quaternion = np.empty(9), np.empty(4)
        for camera, direction in enumerate(self.directions):
            axes = data.cam_xmat[camera].reshape(3, 3)  # columns: right, up, backward
            data.cam_xpos[camera] += self.shift_m * (axes @ direction)
            mujoco.mju_axisAngle2Quat(quaternion, direction, self.turn_rad)
            mujoco.mju_quat2Mat(matrix, quaternion)
            data.cam_xmat[camera] = (axes @ matrix.reshape(3, 3)).ravel()


def camera_move(conditions: Collection[str], *, cameras: int) -> CameraMove | None:
    """Returns how a number of cameras move under conditions; None where they stay."""
    if CAMERA_SHIFTED.name in conditions:
        return CameraMove(cameras, shift_m=CAMERA_SHIFT_M)
    if CAMERA_TURNED.name in conditions:
        return CameraMove(cameras, turn_rad=math.radians(CAMERA_TURN_DEG))
    return None
