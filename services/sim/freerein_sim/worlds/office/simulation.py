"""The office world: a robot that drives and turns among walls and furniture. Where it is follows without physics."""

import math
import struct
from collections.abc import Collection, Sequence

import numpy as np

from freerein_sim.worlds import generators
from freerein_sim.worlds.conditions import light_scale
from freerein_sim.worlds.mujoco_world import MakeWorldExpert, MujocoWorld
from freerein_sim.worlds.office import scene, starts
from freerein_sim.worlds.office.floors import FLOORS
from freerein_sim.worlds.office.rectangles import distance
from freerein_sim.worlds.office.spec import (
    ALONG_PATH,
    FORWARD,
    LEFT,
    ROBOT_RADIUS_M,
    SPEC,
    STAND_STILL,
    STEP_M,
    TURN_DEG,
)
from freerein_sim.worlds.office.starts import Pose
from freerein_sim.worlds.recipes import check_one
from freerein_sim.worlds.world import Action, GroundTruth, StepResult, check_actions, foreign_snapshot, skill_indices

_LAYOUT = struct.Struct(f"<4sbB3d{generators.PACKED_BYTES}s")  # magic, skill of the recipe, contact, pose, noise
_MAGIC = b"ofc1"
_PART_M = 0.01
"""A step is divided into parts of at most this length; the robot stops before the first that touches something."""


class OfficeWorld(MujocoWorld):
    """A wheeled robot on a floor of an office. Only recipes have goals.

    Args:
        floor: Name of the floor.
        make_expert: Makes its experts.
        conditions: Conditions of the task.

    Attributes:
        plan: The floor's plan.
        recipe: Recipe of the episode.
        pose: Where the robot is.
        is_in_contact: Whether it has run into something, which ends the episode.
    """

    def __init__(self, floor: str, make_expert: MakeWorldExpert, conditions: Collection[str] = ()) -> None:
        super().__init__(SPEC, scene.build(floor, light=light_scale(conditions)), make_expert)
        self.plan = FLOORS[floor]
        self.recipe: tuple[str, ...] = ()
        self.pose: Pose = np.zeros(3)
        self.is_in_contact = False
        self._noise = np.random.default_rng(0)
        self._starts_along_path = ALONG_PATH in conditions

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Draws a pose; with a recipe, one from which nothing is seen of the goal's view, or of the path's first one.

        Raises:
            InvalidInput: The recipe is unknown, or more than one skill.
        """
        skill_indices(self.spec, recipe)
        check_one(recipe)
        self._simulation.reset(rng)
        self.pose = self._draw_pose(rng, *recipe)
        self.recipe, self.is_in_contact = tuple(recipe), False
        self._noise = generators.generator(np.random.SeedSequence(int(rng.integers(2**63))))
        self._place_camera()

    def step(self, action: Action) -> StepResult:
        """Drives, turns or stands still. The robot stops where it runs into something, and the episode ends."""
        check_actions(self.spec.action, action)
        choice = int(action[0])
        if choice != STAND_STILL and not self.is_in_contact:
            if choice == FORWARD:
                self._drive(self._noise.uniform(*STEP_M))
            else:
                turn = self._noise.uniform(*TURN_DEG)
                self.pose[2] = (self.pose[2] + (turn if choice == LEFT else -turn)) % 360
            self._place_camera()
        return StepResult(terminated=self.is_in_contact)

    def truth(self) -> GroundTruth:
        """Returns the state that `state_names` names."""
        return GroundTruth(np.append(self.pose, self.is_in_contact), 0.0, success=False)

    def snapshot(self) -> bytes:
        """Returns the complete state."""
        recipe = self.spec.skills.index(self.recipe[0]) if self.recipe else -1
        noise = generators.pack(self._noise)
        return _LAYOUT.pack(_MAGIC, recipe, self.is_in_contact, *self.pose, noise)

    def restore(self, snapshot: bytes) -> None:
        """Restores a snapshot, after checking every number."""
        if len(snapshot) != _LAYOUT.size:
            raise foreign_snapshot(f"a snapshot of this world, {_LAYOUT.size} bytes")
        magic, skill, contact, *numbers, noise = _LAYOUT.unpack(snapshot)
        pose = np.array(numbers)
        if magic != _MAGIC or not -1 <= skill < len(self.spec.skills) or contact > 1 or not self._is_free(pose):
            raise foreign_snapshot()
        self._noise = generators.unpack(noise)
        self.recipe = () if skill < 0 else (self.spec.skills[skill],)
        self.is_in_contact = bool(contact)
        self.pose = pose
        self._place_camera()

    def _draw_pose(self, rng: np.random.Generator, skill: str = "") -> Pose:
        """Draws where the robot begins."""
        if not skill:
            return starts.draw_pose(rng, self.plan)
        if skill in self.plan.goals:
            return starts.draw_start_towards(rng, self.plan, np.array(self.plan.goals[skill]))
        if self._starts_along_path:
            return starts.pose_along(self.plan, skill)
        return starts.draw_start_of(rng, self.plan, skill)

    def _drive(self, length_m: float) -> None:
        heading = math.radians(self.pose[2])
        parts = np.linspace(0, length_m, math.ceil(length_m / _PART_M) + 1)[:, None]
        places = self.pose[:2] + parts * (math.cos(heading), math.sin(heading))
        touches = distance(self.plan.obstacles, places) < ROBOT_RADIUS_M
        self.is_in_contact = bool(touches.any())
        self.pose[:2] = places[touches.argmax() - 1]  # the last one where none touches

    def _is_free(self, pose: Pose) -> bool:
        """Returns whether the robot can be in a pose."""
        is_pose = bool(np.isfinite(pose).all() and 0 <= pose[2] <= 360)
        return is_pose and bool(distance(self.plan.obstacles, pose[None, :2])[0] >= ROBOT_RADIUS_M)

    def _place_camera(self) -> None:
        x, y, heading = self.pose
        half = math.radians(heading) / 2
        self._data.mocap_pos[0] = x, y, 0
        self._data.mocap_quat[0] = math.cos(half), 0, 0, math.sin(half)
        self._simulation.refresh()
