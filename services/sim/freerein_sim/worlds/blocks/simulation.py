"""The blocks world in MuJoCo."""

import logging
import struct
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein_sim.worlds.blocks import CONTROL_DT_S, FINGER_STEP_M, GRIPPER_STEP_M, scene
from freerein_sim.worlds.blocks.expert import BlocksExpert
from freerein_sim.worlds.blocks.goals import BlockGoal, Position, holds
from freerein_sim.worlds.blocks.initial_states import InitialStateSampler
from freerein_sim.worlds.rendering import Renderer, open_renderer
from freerein_sim.worlds.world import (
    Action,
    Frame,
    GroundTruth,
    StepResult,
    WorldSpec,
    check_actions,
    check_view,
    skill_indices,
)

_log = logging.getLogger(__name__)

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
_SUBSTEPS = round(CONTROL_DT_S / scene.TIMESTEP_S)
_HEADER = struct.Struct("<4sI")
_MAGIC = b"fblk"

_FALLEN_M = -0.01
_LEAD_M = 0.07


class BlocksWorld:
    """A gripper and blocks in the plane in which the gripper moves."""

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
        mujoco.set_mju_user_warning(_log.warning)  # else MuJoCo writes MUJOCO_LOG.TXT where the process runs
        built = scene.build(colours, pad=pad)
        self.fingerprint = built.fingerprint
        self._model = built.model
        self._data = mujoco.MjData(self._model)
        self._renderer: Renderer | None = None

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Draws the initial state; the recipe has no effect."""
        skill_indices(self.spec, recipe)
        mujoco.mj_resetData(self._model, self._data)
        start = self._draw_initial_state(rng)
        for colour, place in zip(self.colours, start.blocks, strict=True):
            self._data.joint(colour).qpos = (*place, 1, 0, 0, 0)
        gripper = start.gripper
        here = (*gripper.at, gripper.finger_m, gripper.finger_m)
        targets = (*gripper.at, gripper.target_m, gripper.target_m)
        for i, name in enumerate(("gripper.y", "gripper.z", "finger.left", "finger.right")):
            self._data.joint(name).qpos = here[i]
            self._data.actuator(name).ctrl = targets[i]
        self._refresh()

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
        mujoco.mj_step(self._model, self._data, nstep=_SUBSTEPS)
        if any(self._data.warning[kind].number for kind in _DIVERGED):
            return StepResult(terminated=True, diverged=True)
        self._refresh()
        return StepResult(terminated=any(self.position(colour)[2] < _FALLEN_M for colour in self.colours))

    def render(self, camera: str, *, height: int, width: int) -> Frame:
        """Returns the camera's image; the first call opens an OpenGL context on the calling thread."""
        check_view(self.spec, camera, height=height, width=width)
        if self._renderer is None:
            self._renderer = open_renderer(self._model)
        return self._renderer.render(self._data, camera, height=height, width=width)

    def snapshot(self) -> bytes:
        """Returns MuJoCo's complete integration state."""
        state = np.empty(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self._data, state, _STATE)
        return _HEADER.pack(_MAGIC, state.size) + state.astype("<f8").tobytes()

    def restore(self, snapshot: bytes) -> None:
        """Sets MuJoCo's integration state."""
        size = mujoco.mj_stateSize(self._model, _STATE)
        if len(snapshot) != _HEADER.size + 8 * size or _HEADER.unpack_from(snapshot) != (_MAGIC, size):
            raise InvalidInput(
                f"Expected a snapshot of this world, {_HEADER.size + 8 * size} bytes; got something else.",
                field="snapshot",
            )
        state = np.frombuffer(snapshot, "<f8", offset=_HEADER.size).astype(np.float64)
        if not np.isfinite(state).all():
            raise InvalidInput("Expected a snapshot of finite numbers; got one that is not.", field="snapshot")
        mujoco.mj_resetData(self._model, self._data)
        mujoco.mj_setState(self._model, self._data, state, _STATE)
        self._refresh()

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

    def close(self) -> None:
        """Frees the OpenGL context, on the thread that rendered."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

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

    def _refresh(self) -> None:
        """Updates the rendered poses, which MuJoCo leaves at the start of the last substep."""
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
