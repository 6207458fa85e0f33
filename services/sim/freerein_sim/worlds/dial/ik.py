"""Inverse kinematics: the joint angles that hold the fingertip at a point, pointing down."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.dial import keypad, scene

HOVER_M, PRESS_M = 0.06, -0.03
"""Heights of the targets over the top of a key. The lower one is out of reach, so that the arm keeps pushing."""

Angles = npt.NDArray[np.float64]
"""float64 (6,): angles of the joints, in radians."""

_ITERATIONS = 200
_DAMPING = 1e-4
_DOWN_M, _HOME_M = 0.02, 0.005
"""What one radian off the vertical, and of a joint off the home pose, count as, in metres."""

_MAX_TURN_RAD = 0.2
_LIMIT_MARGIN_RAD = 0.05


@dataclass(frozen=True, eq=False)
class KeyTargets:
    """Joint angles to press each key with.

    Attributes:
        hover: float64 (10, 6), by digit; with the fingertip over the key.
        press: float64 (10, 6), by digit; with the fingertip below the top of the key.
    """

    hover: Angles
    press: Angles


@lru_cache(maxsize=1)
def key_targets() -> KeyTargets:
    """Returns the targets of all keys: those for hovering from the home pose, those for pressing from these."""
    arm = ArmKinematics(scene.build().model)
    hover = [arm.solve((*at, keypad.TOP_M + HOVER_M), near=scene.HOME_RAD) for at in keypad.CENTRES_M]
    press = [
        arm.solve((*at, keypad.TOP_M + PRESS_M), near=angles)
        for at, angles in zip(keypad.CENTRES_M, hover, strict=True)
    ]
    return KeyTargets(np.array(hover), np.array(press))


class ArmKinematics:
    """Kinematics of the arm, without its dynamics and contacts."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        joints = [model.joint(name) for name in scene.JOINTS]
        self._positions = np.array([joint.qposadr[0] for joint in joints])
        self._velocities = np.array([joint.dofadr[0] for joint in joints])
        limits = np.array([joint.range if model.jnt_limited[joint.id] else (-np.inf, np.inf) for joint in joints])
        self._low, self._high = limits[:, 0] + _LIMIT_MARGIN_RAD, limits[:, 1] - _LIMIT_MARGIN_RAD
        self._tip = model.site(scene.FINGERTIP).id

    def fingertip(self, angles: Angles) -> npt.NDArray[np.float64]:
        """Returns where the fingertip is, float64 (3,), in metres."""
        self._move(angles)
        return np.array(self._data.site_xpos[self._tip])

    def solve(self, target: Sequence[float], *, near: Sequence[float] | Angles) -> Angles:
        """Returns angles that bring the fingertip to a point, by damped least squares.

        Args:
            target: The point: x, y and z, in metres.
            near: Angles to begin with; they decide which of several solutions is found.
        """
        angles = np.array(near, np.float64)
        for _ in range(_ITERATIONS):
            error, jacobian = self._linearise(angles, target)
            turn = np.linalg.solve(jacobian.T @ jacobian + _DAMPING * np.eye(len(angles)), jacobian.T @ error)
            turn *= min(1.0, _MAX_TURN_RAD / max(float(np.abs(turn).max()), 1e-12))
            angles = np.clip(angles + turn, self._low, self._high)
        return angles

    def _linearise(self, angles: Angles, target: Sequence[float]) -> tuple[Angles, npt.NDArray[np.float64]]:
        """Returns the errors of position, direction and posture, float64 (12,), and their Jacobian, (12, 6)."""
        self._move(angles)
        mujoco.mj_comPos(self._model, self._data)
        moved, turned = np.empty((3, self._model.nv)), np.empty((3, self._model.nv))
        mujoco.mj_jacSite(self._model, self._data, moved, turned, self._tip)
        pointing = -self._data.site_xmat[self._tip].reshape(3, 3)[:, 2]
        position = target - self._data.site_xpos[self._tip]
        direction = _DOWN_M * np.cross(pointing, (0, 0, -1))
        posture = _HOME_M * (scene.HOME_RAD - angles)
        arm = self._velocities
        jacobian = np.concatenate([moved[:, arm], _DOWN_M * turned[:, arm], _HOME_M * np.eye(len(arm))])
        return np.concatenate([position, direction, posture]), jacobian

    def _move(self, angles: Angles) -> None:
        self._data.qpos[self._positions] = angles
        mujoco.mj_kinematics(self._model, self._data)
