"""The blocks world in MuJoCo."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein_sim.worlds.blocks import scene
from freerein_sim.worlds.blocks.distractors import DISTRACTORS
from freerein_sim.worlds.blocks.goals import BlockGoal
from freerein_sim.worlds.blocks.initial_states import PARKED_M, InitialStateSampler
from freerein_sim.worlds.blocks.relations import Position, holds, is_visible
from freerein_sim.worlds.blocks.spec import COLOURS, CONTROL_DT_S, FINGER_STEP_M, GRIPPER_STEP_M
from freerein_sim.worlds.blocks.variation import Variation
from freerein_sim.worlds.camera_moves import CameraMove
from freerein_sim.worlds.generators import jumped
from freerein_sim.worlds.mujoco_world import MakeWorldExpert, MujocoWorld
from freerein_sim.worlds.world import Action, GroundTruth, StepResult, WorldSpec, check_actions, skill_indices

_SUBSTEPS = round(CONTROL_DT_S / scene.TIMESTEP_S)
_FALLEN_M = -0.01
_LEAD_M = 0.07
_PARKED_POSES = {colour: np.array([*place, 1, 0, 0, 0]) for colour, place in zip(COLOURS, PARKED_M, strict=True)}


class BlocksWorld(MujocoWorld):
    """A gripper and blocks in the plane in which the gripper moves.

    Args:
        spec: The task's spec.
        colours: Colours of the simulated blocks. The true state has the others as hidden ones.
        draw_initial_state: Draws initial states.
        variation: How the world differs from the nominal one.
        goal: The goal; None for none.
        make_expert: Makes its experts; None for a task without.
    """

    def __init__(
        self,
        spec: WorldSpec,
        colours: tuple[str, ...],
        draw_initial_state: InitialStateSampler,
        variation: Variation,
        *,
        goal: BlockGoal | None = None,
        make_expert: MakeWorldExpert | None = None,
    ) -> None:
        built = scene.build(
            colours,
            pad=variation.fewest_blocks < len(colours),
            light=variation.light,
            distractor=variation.distractor,
        )
        super().__init__(spec, built, make_expert, _camera_move(variation))
        self.goal = goal
        self.variation = variation
        self._colours = colours
        self._draw_initial_state = draw_initial_state

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Draws the initial state. The blocks that a recipe names are on show; that is all its effect."""
        wanted = self.named(recipe)
        if len(set(wanted)) > self.variation.blocks:
            raise InvalidInput(
                f"A recipe must name at most {self.variation.blocks} blocks, those on show; got {len(set(wanted))}.",
                field="skills",
            )
        self._simulation.reset(rng)
        if self.variation.distractor:
            DISTRACTORS[self.variation.distractor].show(self._data, jumped(rng))
        start = self._draw_initial_state(rng, wanted)
        for colour in self._colours:
            self._data.joint(colour).qpos = (*start.blocks[COLOURS.index(colour)], 1, 0, 0, 0)
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
        return StepResult(terminated=any(self.position(colour)[2] < _FALLEN_M for colour in self._colours))

    def truth(self) -> GroundTruth:
        """Returns the poses of gripper and blocks, and whether the goal holds."""
        poses = [
            self._data.joint(colour).qpos if colour in self._colours else _PARKED_POSES[colour] for colour in COLOURS
        ]
        opening = self._data.joint("finger.left").qpos + self._data.joint("finger.right").qpos
        success = self.goal is not None and bool(
            holds(self.goal.relation, self.position(self.goal.first), self.position(self.goal.second))
        )
        return GroundTruth(np.concatenate([self.gripper, opening, *poses]), float(success), success)

    @property
    def visible_colours(self) -> tuple[str, ...]:
        """Colours of the blocks on show."""
        return tuple(colour for colour in self._colours if is_visible(self.position(colour)))

    @property
    def gripper(self) -> npt.NDArray[np.float64]:
        """Midpoint between the fingers: float64 (2,), y and z in metres."""
        return np.concatenate([self._data.joint("gripper.y").qpos, self._data.joint("gripper.z").qpos])

    @property
    def set_point(self) -> npt.NDArray[np.float64]:
        """Set-points of the servos: float64 (3,), y, z and each finger's distance from the midpoint, in metres."""
        return np.array(self._data.ctrl[:3])

    def position(self, colour: str) -> Position:
        """Returns the centre of a block, float64 (3,)."""
        return np.array(self._data.joint(colour).qpos[:3])

    def named(self, skills: Sequence[str]) -> tuple[str, ...]:
        """Returns the colours that skills name. Raises InvalidInput for an unknown skill."""
        skill_indices(self.spec, skills)
        return tuple(skill.removeprefix("move-") for skill in skills)


def _camera_move(variation: Variation) -> CameraMove | None:
    if not (variation.camera_shift_m or variation.camera_turn_deg):
        return None
    return CameraMove(len(scene.CAMERAS), variation.camera_shift_m, math.radians(variation.camera_turn_deg))
