"""Kinematics of the arm: where its gripper is, and the joint angles that bring it elsewhere, pointing down."""

import mujoco
import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.bins import scene
from freerein_sim.worlds.bins.layout import Place

HOME_RAD = np.array([-0.13, -1.02, 0.05, 1.77, -0.03, 0.82, 3.24])
"""Joint angles to which the arm stays close, as far as the gripper's pose leaves a choice."""

_AXES = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
"""Axes of the gripper, by column: it points down, and its fingers move along x."""

_ITERATIONS = 20
_DAMPING = 1e-4
_HOMING = 0.2
_NEAR_M = 1e-4
_FAR_M = 0.01

Angles = npt.NDArray[np.float64]
"""float64 (7,): joint angles in radians."""


class Arm:
    """Forward and inverse kinematics. A call's result does not depend on earlier calls."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        joints = [model.joint(name) for name in scene.ARM]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self._range = np.array([joint.range for joint in joints])
        self._grip = model.site(scene.GRIP).id

    def reach(self, angles: Angles) -> Place:
        """Returns the place between the fingertips at joint angles."""
        self._data.qpos[self._qpos] = angles
        mujoco.mj_kinematics(self._model, self._data)
        return np.array(self._data.site_xpos[self._grip])

    def solve(self, place: Place, start: Angles) -> Angles:
        """Returns joint angles that bring the gripper to a place, by damped least squares from `start`.

        Where that does not come within a centimetre, returns `start`.
        """
        angles = np.array(start)
        jacobian = np.empty((6, self._model.nv))
        for _ in range(_ITERATIONS):
            offset = place - self.reach(angles)
            axes = self._data.site_xmat[self._grip].reshape(3, 3)
            turn = _turn(axes)
            if max(np.abs(offset).max(), np.abs(turn).max()) < _NEAR_M:
                break
            mujoco.mj_comPos(self._model, self._data)
            mujoco.mj_jacSite(self._model, self._data, jacobian[:3], jacobian[3:], self._grip)
            of_arm = jacobian[:, self._dofs]  # (6, 7)
            inverse = of_arm.T @ np.linalg.inv(of_arm @ of_arm.T + _DAMPING * np.eye(6))  # (7, 6)
            homing = _HOMING * (HOME_RAD - angles)
            angles += inverse @ (np.concatenate([offset, turn]) - of_arm @ homing) + homing
            angles = np.clip(angles, *self._range.T)
        return angles if np.abs(place - self.reach(angles)).max() < _FAR_M else np.array(start)


def _turn(axes: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns the small rotation, float64 (3,) in radians, that takes these axes of the gripper to its own."""
    rotation = _AXES @ axes.T
    apart = rotation - rotation.T
    return 0.5 * np.array([apart[2, 1], apart[0, 2], apart[1, 0]])
