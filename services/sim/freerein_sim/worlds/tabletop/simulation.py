"""The tabletop world in MuJoCo."""

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.mujoco_world import MakeWorldExpert, MujocoWorld, Scene
from freerein_sim.worlds.tabletop import appearance, initial_states, scene, things
from freerein_sim.worlds.tabletop.recipes import task_of
from freerein_sim.worlds.tabletop.spec import CONTROL_DT_S, HAND_STEP, OPENING_STEP_M
from freerein_sim.worlds.world import Action, GroundTruth, StepResult, WorldSpec, check_actions, foreign_snapshot

_SUBSTEPS = round(CONTROL_DT_S / scene.TIMESTEP_S)
_GRASP_M = 0.025
"""Greatest distance between the point between the fingertips and a thing that closing fingers grasp."""

_RELEASE_M = 0.008
"""How far the fingers open beyond the width of the thing that they hold to release it."""

_WIPED_M = -0.1
"""Height at which spots are that were wiped away, under the table."""

_WIPING_M = 0.012
"""Greatest height of a wiping sponge's lower side."""

_STAIN_M = np.array([(x, y) for x in (-0.5, 0.5) for y in (-1.0, 0.0, 1.0)]) * things.SPOT_PITCH_M
"""Offset of each spot from the middle of the stain: float64 (6, 2)."""

_REST_M = {**{thing.name: thing.rest_m for thing in things.THINGS}, "base": things.BASE_HALF_M}
_ON_SHOW_M = -1.0
_POSE_PART = slice(3, 10)
"""Where a weld's data have the held body's pose in the hand: position, quaternion."""

_OWN_NUMBERS = appearance.LOW.size + 7 * len(things.THINGS) + 1
"""Numbers in a snapshot before MuJoCo's: the appearance, a pose for each weld, and the episode's task."""

_ROUNDING = 1e-6

Point = npt.NDArray[np.float64]
"""float64 (3,) in metres."""


class TabletopWorld(MujocoWorld):
    """A flying hand and things on a table.

    Args:
        spec: The task's spec.
        make_expert: Makes its demonstrators.
        only_own: Whether only what a recipe's task uses is on show.

    Attributes:
        thing: The thing that the episode's task uses.
    """

    def __init__(self, spec: WorldSpec, make_expert: MakeWorldExpert, *, only_own: bool) -> None:
        shared = scene.build()
        self._nominal, self._model = shared.model, copy.copy(shared.model)
        super().__init__(spec, Scene(self._model, shared.fingerprint), make_expert)
        self._only_own = only_own
        self._dress((appearance.LOW + appearance.HIGH) / 2)
        self.thing = things.THINGS[0]

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Draws the initial state. A recipe has an effect on it only where no more than its objects are on show."""
        task, drawn = task_of(recipe), things.THINGS[int(rng.integers(len(things.THINGS)))]
        self.thing = things.thing_of(task) if task else drawn
        on_show = (self.thing.name, self.thing.used_on) if self._only_own else things.SCALED
        self._simulation.reset(rng)
        self._model.eq_data[:] = self._nominal.eq_data
        self._dress(appearance.draw(rng))
        start = initial_states.draw(rng, on_show)
        for name in things.FREE_BODIES:
            yaw = start.yaws_rad[name]
            place = (*start.places_m[name], self.scale(name) * _REST_M[name])
            self._data.joint(name).qpos = (*place, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
        for name in things.PLACED_BODIES:
            self._move(name, (*start.places_m[name], 0))
        for name, offset in zip(things.SPOTS, self.scale("stain") * _STAIN_M, strict=True):
            self._move(name, (*(start.places_m["stain"] + offset), 0))
        for name, value in zip(scene.HAND_JOINTS, start.hand, strict=True):
            self._data.joint(name).qpos = value
        for side in ("left", "right"):
            self._data.joint(f"finger.{side}").qpos = start.opening_m / 2
        self._set_servos(start.hand, start.opening_m)
        self._simulation.refresh()

    def step(self, action: Action) -> StepResult:
        """Moves the servos' set-points by the action and simulates one control step.

        Fingers that close around a thing hold it, until they open.
        """
        check_actions(self.spec.action, action)
        before = self.set_point
        hand = np.clip(before[:5] + HAND_STEP * action[:5], scene.HAND_LOW, scene.HAND_HIGH)
        opening = float(np.clip(before[5] + OPENING_STEP_M * action[5], *scene.OPENING_M))
        held = self.held
        if held is not None and opening > self.width(held) + _RELEASE_M:
            self._data.eq_active[:] = 0
        elif held is not None:
            opening = max(opening, self.width(held))
        self._set_servos(hand, opening)
        if self._simulation.step(_SUBSTEPS):
            return StepResult(terminated=True, diverged=True)
        self._simulation.refresh()
        if held is None and opening < before[5]:
            self._grasp(opening)
        self._wipe()
        return StepResult(terminated=False)

    def truth(self) -> GroundTruth:
        """Returns the state that `predicates.STATE_NAMES` names; there is no goal."""
        state = np.concatenate(
            [
                [float(self._data.joint(name).qpos[0]) for name in scene.HAND_JOINTS],
                [sum(float(self._data.joint(f"finger.{side}").qpos[0]) for side in ("left", "right"))],
                [0 if self.held is None else 1 + things.THINGS.index(self.held)],
                *(self._data.joint(name).qpos for name in things.FREE_BODIES),
                *(self.position(name)[:2] for name in (*things.PLACED_BODIES, "stain")),
                [sum(self.position(name)[2] > _WIPED_M for name in things.SPOTS)],
                self.point("cup", (0, 0, things.CUP_HALF_M)),
                self.point("spoon", (things.SPOON_TIP_M, 0, 0)),
                [self.scale("bowl") * things.BOWL_RADIUS_M],
                [self.scale("pot") * things.POT_RADIUS_M, self.scale("pot") * things.POT_HEIGHT_M],
                [self.scale("box") * things.BOX_HALF_M, self.scale("box") * things.BOX_HEIGHT_M],
                [2 * self.scale("block") * things.BLOCK_HALF_M, 2 * self.scale("base") * things.BASE_HALF_M],
            ]
        )
        return GroundTruth(state, 0.0, success=False)

    def snapshot(self) -> bytes:
        """Returns the episode's task, the appearance, how each thing was last held, and MuJoCo's integration state."""
        own = (self._appearance, self._model.eq_data[:, _POSE_PART].ravel(), [things.THINGS.index(self.thing)])
        return np.concatenate(own).astype("<f8").tobytes() + super().snapshot()

    def restore(self, snapshot: bytes) -> None:
        """Restores a snapshot, after checking every number."""
        size = 8 * _OWN_NUMBERS
        if len(snapshot) < size:
            raise foreign_snapshot()
        own = np.frombuffer(snapshot[:size], "<f8").astype(np.float64)
        drawn, welds, task = np.split(own, [appearance.LOW.size, _OWN_NUMBERS - 1])
        poses = welds.reshape(len(things.THINGS), -1)
        in_range = (drawn >= appearance.LOW) & (drawn <= appearance.HIGH)
        is_near = np.abs(poses[:, :3]) < _GRASP_M + _ROUNDING
        is_turn = np.abs(np.linalg.norm(poses[:, 3:], axis=1) - 1) < _ROUNDING
        is_task = np.isin(task, range(len(things.THINGS)))
        if not all(each.all() for each in (in_range, is_near, is_turn, is_task)):
            raise foreign_snapshot()
        super().restore(snapshot[size:])
        self._dress(drawn)
        self.thing = things.THINGS[int(task[0])]
        self._model.eq_data[:, _POSE_PART] = poses
        self._simulation.refresh()

    @property
    def held(self) -> things.Thing | None:
        """The thing in the hand."""
        return next((thing for thing, weld in zip(things.THINGS, self._data.eq_active, strict=True) if weld), None)

    @property
    def set_point(self) -> npt.NDArray[np.float64]:
        """Set-points of the servos: float64 (6,), x, y, z, pitch, roll and the distance between the fingers."""
        fingers = self._data.actuator("finger.left").ctrl + self._data.actuator("finger.right").ctrl
        return np.append([self._data.actuator(name).ctrl[0] for name in scene.HAND_JOINTS], fingers)

    @property
    def hand(self) -> tuple[Point, npt.NDArray[np.float64]]:
        """The point between the fingertips, and the hand's axes as columns: float64 (3, 3)."""
        hand = self._data.body("hand")
        return np.array(hand.xpos), np.array(hand.xmat).reshape(3, 3)

    def scale(self, name: str) -> float:
        """Returns the factor of a thing's nominal size."""
        return self._scales[name]

    def width(self, thing: things.Thing) -> float:
        """Returns the distance of fingers that hold a thing, in metres."""
        return self.scale(thing.name) * thing.width_m

    def position(self, name: str) -> Point:
        """Returns the origin of a thing; of the stain, its middle."""
        if name == "stain":
            return np.asarray(np.mean([self.position(spot) for spot in things.SPOTS], axis=0))
        return np.array(self._data.body(name).xpos)

    def point(self, name: str, offset: tuple[float, float, float]) -> Point:
        """Returns a point of a thing that is nominally at an offset from its origin, in its own axes."""
        axes = np.array(self._data.body(name).xmat).reshape(3, 3)
        return self.position(name) + axes @ (self.scale(name) * np.array(offset))

    def is_on_show(self, thing: things.Thing) -> bool:
        """Returns whether a thing is on the table, not on the pad."""
        return bool(self.position(thing.name)[0] > _ON_SHOW_M)

    def _dress(self, drawn: appearance.Appearance) -> None:
        self._appearance, self._scales = drawn, appearance.scales(drawn)
        appearance.apply(self._model, self._nominal, drawn)

    def _set_servos(self, hand: npt.NDArray[np.float64], opening_m: float) -> None:
        for name, target in zip(scene.HAND_JOINTS, hand, strict=True):
            self._data.actuator(name).ctrl = target
        for side in ("left", "right"):
            self._data.actuator(f"finger.{side}").ctrl = opening_m / 2

    def _move(self, name: str, place: Sequence[float]) -> None:
        self._data.mocap_pos[self._model.body(name).mocapid] = place

    def _grasp(self, opening_m: float) -> None:
        """Holds the thing that the fingers have closed around, if any."""
        hand, turn_back = self._data.body("hand"), np.empty(4)
        for i, thing in enumerate(things.THINGS):
            offset = self.position(thing.name) - hand.xpos
            if np.linalg.norm(offset) < _GRASP_M and opening_m <= self.width(thing):
                weld = self._model.eq_data[i, _POSE_PART]
                mujoco.mju_negQuat(turn_back, hand.xquat)
                mujoco.mju_rotVecQuat(weld[:3], offset, turn_back)
                mujoco.mju_mulQuat(weld[3:], turn_back, self._data.body(thing.name).xquat)
                self._data.eq_active[i] = 1
                return

    def _wipe(self) -> None:
        """Takes away the spots under a sponge that is on the table."""
        sponge = self._data.body("sponge")
        if sponge.xpos[2] > self.scale("sponge") * things.SPONGE_HALF_M[2] + _WIPING_M:
            return
        for name in things.SPOTS:
            offset = sponge.xmat.reshape(3, 3).T @ (self.position(name) - sponge.xpos)
            if (np.abs(offset[:2]) < self.scale("sponge") * np.array(things.SPONGE_HALF_M[:2])).all():
                self._move(name, (*self.position(name)[:2], 2 * _WIPED_M))
        self._simulation.refresh()
