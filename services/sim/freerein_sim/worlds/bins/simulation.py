"""The bins world in MuJoCo."""

from collections.abc import Sequence

import numpy as np

from freerein_sim.worlds.bins import initial_states, scene
from freerein_sim.worlds.bins.arm import HOME_RAD, Arm
from freerein_sim.worlds.bins.layout import FLOOR_M, GROCERIES, Grocery, Place
from freerein_sim.worlds.bins.predicates import is_placed
from freerein_sim.worlds.bins.spec import CONTROL_DT_S, FINGER_STEP_M, GRIPPER_STEP_M
from freerein_sim.worlds.mujoco_world import MakeWorldExpert, MujocoWorld, Scene
from freerein_sim.worlds.world import Action, GroundTruth, StepResult, WorldSpec, check_actions, skill_indices

WORKSPACE_M = np.array([[-0.07, -0.47, 0.836], [0.27, 0.48, 1.2]])
"""Lowest and highest x, y, z of the gripper's set-point."""

_MOVES = 25
"""Times that the servos' set-points move on in a control step."""

_SUBSTEPS = round(CONTROL_DT_S / scene.TIMESTEP_S / _MOVES)
_LEAD_M = 0.3
_FALLEN_M = FLOOR_M - 0.1


class BinsWorld(MujocoWorld):
    """A Sawyer, two bins and four groceries."""

    def __init__(self, spec: WorldSpec, built: Scene, make_expert: MakeWorldExpert) -> None:
        super().__init__(spec, built, make_expert)
        self._arm = Arm(built.model)
        self._arm_controls = [self._data.actuator(name).id for name in scene.ARM]
        self._finger_controls = [self._data.actuator(name).id for name in scene.FINGERS]

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Draws the initial state, on which a recipe has no effect."""
        skill_indices(self.spec, recipe)
        self._simulation.reset(rng)
        start = initial_states.draw(rng)
        for grocery, pose in zip(GROCERIES, start.poses, strict=True):
            self._data.joint(grocery.name).qpos = pose
        angles = self._arm.solve(start.gripper, HOME_RAD)
        for name, angle in zip(scene.ARM, angles, strict=True):
            self._data.joint(name).qpos = angle
        for name, opening in scene.FINGERS.items():
            self._data.joint(name).qpos = opening * scene.FINGER_M[1]
        self._data.ctrl[self._arm_controls] = angles
        self._set_fingers(scene.FINGER_M[1])
        self._simulation.refresh()

    def step(self, action: Action) -> StepResult:
        """Moves the gripper's set-point by the action, and the servos to it, while it simulates one control step.

        The lead of the set-point over the gripper is limited, so that a blocked gripper does not wind up.
        """
        check_actions(self.spec.action, action)
        here = self.gripper
        begin = np.array(self._data.ctrl[self._arm_controls])
        target = self._arm.reach(begin) + GRIPPER_STEP_M * action[:3]
        target = np.clip(np.clip(target, here - _LEAD_M, here + _LEAD_M), *WORKSPACE_M)
        end = self._arm.solve(target, begin)
        self._set_fingers(self.finger_set_point + FINGER_STEP_M * float(action[3]))
        for move in range(1, _MOVES + 1):
            self._data.ctrl[self._arm_controls] = begin + move / _MOVES * (end - begin)
            if self._simulation.step(_SUBSTEPS):
                return StepResult(terminated=True, diverged=True)
        self._simulation.refresh()
        return StepResult(terminated=any(self.position(each)[2] < _FALLEN_M for each in GROCERIES))

    def truth(self) -> GroundTruth:
        """Returns the poses of gripper and groceries; the task has no goal."""
        poses = [self._data.joint(each.name).qpos for each in GROCERIES]
        return GroundTruth(np.concatenate([self.gripper, [self.opening_m], *poses]), 0.0, False)

    @property
    def gripper(self) -> Place:
        """Place between the fingertips, float64 (3,)."""
        return np.array(self._data.site(scene.GRIP).xpos)

    @property
    def set_point(self) -> Place:
        """Place to which the servos bring the gripper, float64 (3,)."""
        return self._arm.reach(np.array(self._data.ctrl[self._arm_controls]))

    @property
    def finger_set_point(self) -> float:
        """Set-point of each finger's joint, in metres; the greatest is open."""
        return float(self._data.ctrl[self._finger_controls[0]]) * next(iter(scene.FINGERS.values()))

    @property
    def opening_m(self) -> float:
        """Distance between the fingers."""
        opened = sum(sign * float(self._data.joint(name).qpos[0]) for name, sign in scene.FINGERS.items())
        return opened + 2 * scene.FINGER_BASE_M

    def position(self, grocery: Grocery) -> Place:
        """Returns where a grocery's origin is, float64 (3,)."""
        return np.array(self._data.joint(grocery.name).qpos[:3])

    def is_placed(self, grocery: Grocery) -> bool:
        """Returns whether a grocery lies in its compartment, released."""
        return bool(
            is_placed(grocery, self.position(grocery), gripper=self.gripper, opening_m=np.array(self.opening_m))
        )

    def _set_fingers(self, opened: float) -> None:
        opened = float(np.clip(opened, *scene.FINGER_M))
        for control, sign in zip(self._finger_controls, scene.FINGERS.values(), strict=True):
            self._data.ctrl[control] = sign * opened
