"""Gymnasium's InvertedDoublePendulum-v5 from pixels: two poles on a cart, balanced upright.

Dynamics, initial noise, termination and oracle reward are Gymnasium's; its MJCF is read as data from its wheel.
"""

import math
import struct
from collections.abc import Collection, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.conditions import LIGHT_CONDITIONS, LIGHTS, light_scale
from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.world import (
    Action,
    GroundTruth,
    StepResult,
    TaskDefinition,
    World,
    WorldSpec,
    check_actions,
    foreign_snapshot,
    skill_indices,
)

if TYPE_CHECKING:
    from freerein_sim.worlds.mujoco_world import MujocoSimulation, Scene

SPEC = WorldSpec(
    cameras=(Camera("front", 84, 84, 3),),
    action=ActionSpec(size=1, choices=0, names=("force",), unit="N", scale=(500.0,)),
    control_dt_s=0.05,
    skills=(),
    max_episode_steps=1000,
    state_names=("cart.x", "lower.angle", "upper.angle", "cart.vx", "lower.velocity", "upper.velocity"),
)

_SUBSTEPS = 5
_NOISE = 0.1
_FALLEN_M = 1.0
"""Height of the tip at which the episode terminates; upright it is 1.2 m."""

_ALIVE = 10.0
_REWARD = struct.Struct("<d")
_CAMERA_AT_M, _CAMERA_QUATERNION = (0.0, -2.9, 0.5), (0.5**0.5, 0.5**0.5, 0.0, 0.0)  # looks along y; z is up


class PendulumWorld:
    """The pendulum; it has no scripted expert."""

    spec = SPEC
    expert = steps = None

    def __init__(self, simulation: "MujocoSimulation") -> None:
        self.fingerprint = simulation.fingerprint
        self._simulation = simulation
        self._reward = 0.0
        self.render, self.close = simulation.render, simulation.close

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Draws positions and velocities near the upright pose; the recipe has no effect."""
        skill_indices(SPEC, recipe)
        self._simulation.reset(rng)
        data = self._simulation.data
        data.qpos += rng.uniform(-_NOISE, _NOISE, size=data.qpos.shape)
        data.qvel += _NOISE * rng.standard_normal(data.qvel.shape)
        self._simulation.refresh()
        self._update_reward()

    def step(self, action: Action) -> StepResult:
        """Pushes the cart for one control step."""
        check_actions(SPEC.action, action)
        self._simulation.data.ctrl[:] = action
        diverged = self._simulation.step(_SUBSTEPS)
        terminated = diverged or self._update_reward()
        self._simulation.refresh()
        return StepResult(terminated, diverged)

    def snapshot(self) -> bytes:
        """Returns MuJoCo's integration state and the reward, which is of poses that are not part of it."""
        return self._simulation.snapshot() + _REWARD.pack(self._reward)

    def restore(self, snapshot: bytes) -> None:
        """Sets MuJoCo's integration state and the reward."""
        state, packed = snapshot[: -_REWARD.size], snapshot[-_REWARD.size :]
        if len(packed) != _REWARD.size or not math.isfinite(_REWARD.unpack(packed)[0]):
            raise foreign_snapshot()
        self._simulation.restore(state)
        (self._reward,) = _REWARD.unpack(packed)

    def truth(self) -> GroundTruth:
        """Returns positions and velocities; the pendulum has no goal to reach."""
        data = self._simulation.data
        return GroundTruth(np.concatenate([data.qpos, data.qvel]), self._reward, success=False)

    def _update_reward(self) -> bool:
        """Computes the reward; returns whether the pendulum has fallen.

        As in Gymnasium, the tip's position is where the last substep began, and the velocities where it ended.
        """
        x, _, height = self._simulation.data.site("tip").xpos
        lower, upper = self._simulation.data.qvel[1:]
        fallen = bool(height <= _FALLEN_M)
        off_target = 0.01 * x**2 + (height - 2) ** 2
        speed = 1e-3 * lower**2 + 5e-3 * upper**2
        self._reward = float(_ALIVE * (not fallen) - off_target - speed)
        return fallen


def _make(conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.mujoco_world import MujocoSimulation

    return PendulumWorld(MujocoSimulation(SPEC, _scene(light_scale(conditions))))


@lru_cache(maxsize=1 + len(LIGHTS))
def _scene(light: float) -> "Scene":
    """Returns Gymnasium's model with a camera."""
    import mujoco

    from freerein_sim.worlds.mujoco_world import asset_folder, compile_scene

    folder = asset_folder("gymnasium") / "envs" / "mujoco" / "assets"
    spec = mujoco.MjSpec.from_file(str(folder / "inverted_double_pendulum.xml"))
    spec.worldbody.add_camera(name="front", pos=_CAMERA_AT_M, quat=_CAMERA_QUATERNION)
    return compile_scene(spec, light=light)


TASKS = (TaskDefinition("pendulum", "pendulum", "", SPEC, _make, own_conditions=LIGHT_CONDITIONS),)
