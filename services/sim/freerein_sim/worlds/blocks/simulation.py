"""The blocks world in MuJoCo."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.blocks import CONTROL_DT_S, FINGER_STEP_M, GRIPPER_STEP_M, scene
from freerein_sim.worlds.blocks.expert import BlocksExpert
from freerein_sim.worlds.blocks.goals import BlockGoal, Position, holds
from freerein_sim.worlds.blocks.initial_states import InitialStateSampler
from freerein_sim.worlds.mujoco_world import MujocoSimulation
from freerein_sim.worlds.world import (
    Action,
    GroundTruth,
    StepResult,
    WorldSpec,
    check_actions,
    skill_indices,
)

_SUBSTEPS = round(CONTROL_DT_S / scene.TIMESTEP_S)
_FALLEN_M = -0.01
_LEAD_M = 0.07


class BlocksWorld:
    """A gripper and blocks in the plane in which the gripper moves."""

    steps = None

    def __init__(
        self,
        spec: WorldSpec,
        colours: tuple[str, ...],
        draw_initial_state: InitialStateSampler,
        *,
        goal: BlockGoal | None = None,
        pad: bool = False,
    ) -> None:
        self.spec = spec
        self.colours = colours
        self.goal = goal
        self._draw_initial_state = draw_initial_state
        self._simulation = simulation = MujocoSimulation(spec, scene.build(colours, pad=pad))
        self.fingerprint = simulation.fingerprint
        self._data = simulation.data
        self.snapshot, self.restore = simulation.snapshot, simulation.restore
        self.render, self.close = simulation.render, simulation.close

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Draws the initial state; the recipe has no effect."""
        skill_indices(self.spec, recipe)
        self._simulation.reset()
        start = self._draw_initial_state(rng)
        for colour, place in zip(self.colours, start.blocks, strict=True):
            self._data.joint(colour).qpos = (*place, 1, 0, 0, 0)
        gripper = start.gripper
        here = (*gripper.at, gripper.finger_m, gripper.finger_m)
        targets = (*gripper.at, gripper.target_m, gripper.target_m)
        for i, name in enumerate(("gripper.y", "gripper.z", "finger.left", "finger.right")):
            self._data.joint(name).qpos = here[i]
            self._data.actuator(name).ctrl = targets[i]
        self._simulation.refresh()

    def step(self, action: Action) -> StepResult:
        """Moves the servos' set-points by the action and simulates one control step.

        The lead of the set-point over the gripper is limited, so that a blocked gripper does not wind up.
        """
        check_actions(self.spec.action, action)
        here = self.gripper
        control = self._data.ctrl
        for i, limits in enumerate((scene.GRIPPER_Y_M, scene.GRIPPER_Z_M)):
            target = control[i] + GRIPPER_STEP_M * float(action[i])
            target = np.clip(target, here[i] - _LEAD_M, here[i] + _LEAD_M)
            control[i] = np.clip(target, *limits)
        control[2:] = np.clip(control[2] + FINGER_STEP_M * float(action[2]), *scene.FINGER_M)
        if self._simulation.step(_SUBSTEPS):
            return StepResult(terminated=True, diverged=True)
        self._simulation.refresh()
        return StepResult(terminated=any(self.position(colour)[2] < _FALLEN_M for colour in self.colours))

    def truth(self) -> GroundTruth:
        """Returns the poses of gripper and blocks, and whether the goal holds."""
        poses = [self._data.joint(colour).qpos for colour in self.colours]
        opening = self._data.joint("finger.left").qpos + self._data.joint("finger.right").qpos
        success = self.goal is not None and holds(
            self.goal.relation, self.position(self.goal.first), self.position(self.goal.second)
        )
        return GroundTruth(np.concatenate([self.gripper, opening, *poses]), float(success), success)

    def expert(self, skills: Sequence[str], rng: np.random.Generator) -> BlocksExpert:
        """Returns an expert that picks up each named block and places it elsewhere, or at the goal if there is one."""
        skill_indices(self.spec, skills)
        return BlocksExpert(self, tuple(skills) or self.spec.skills, self.goal, rng)

    @property
    def gripper(self) -> npt.NDArray[np.float64]:
        """Midpoint between the fingers: float64 (2,), y and z in metres."""
        return np.concatenate([self._data.joint("gripper.y").qpos, self._data.joint("gripper.z").qpos])

    @property
    def set_point(self) -> npt.NDArray[np.float64]:
        """Set-points of the servos: float64 (3,), y, z and each finger's distance from the midpoint, in metres."""
        return np.array(self._data.ctrl[:3])

    def position(self, colour: str) -> Position:
        """Returns the centre of a block."""
        return np.array(self._data.joint(colour).qpos[:3])
