"""The dial world in MuJoCo."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.dial import scene
from freerein_sim.worlds.dial.keypad import DIGITS
from freerein_sim.worlds.dial.spec import CONTROL_DT_S
from freerein_sim.worlds.mujoco_world import MakeWorldExpert, MujocoWorld, Scene
from freerein_sim.worlds.world import Action, GroundTruth, StepResult, WorldSpec, check_actions, skill_indices

_SUBSTEPS = round(CONTROL_DT_S / scene.TIMESTEP_S)
_START_NOISE_RAD = (0.3, 0.15, 0.15, 0.15, 0.15, 0.15)

Vector = npt.NDArray[np.float64]


class DialWorld(MujocoWorld):
    """The arm and its keypad; it has no goal, and displays no recipe."""

    def __init__(self, spec: WorldSpec, built: Scene, make_expert: MakeWorldExpert) -> None:
        super().__init__(spec, built, make_expert)
        self._joints = [self._data.joint(name) for name in scene.JOINTS]
        self._keys = [self._data.joint(f"key-{digit}") for digit in DIGITS]
        self._tip = self._data.site(scene.FINGERTIP)

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Draws the arm's pose near the middle of the keypad; the recipe has no effect."""
        skill_indices(self.spec, recipe)
        self._simulation.reset(rng)
        noise = rng.uniform(-1, 1, len(self._joints)) * _START_NOISE_RAD
        for joint, angle in zip(self._joints, scene.HOME_RAD + noise, strict=True):
            joint.qpos = angle
        self._simulation.refresh()

    def step(self, action: Action) -> StepResult:
        """Applies torques for one control step."""
        check_actions(self.spec.action, action)
        self._data.ctrl[:] = action
        diverged = self._simulation.step(_SUBSTEPS)
        self._simulation.refresh()
        return StepResult(terminated=diverged, diverged=diverged)

    def truth(self) -> GroundTruth:
        """Returns angles, fingertip and how far each key is pushed down; there is no goal to reach."""
        return GroundTruth(np.concatenate([self.angles, self.fingertip, self.depths]), 0.0, success=False)

    @property
    def angles(self) -> Vector:
        """Angles of the arm's joints: float64 (6,), in radians."""
        return np.concatenate([joint.qpos for joint in self._joints])

    @property
    def velocities(self) -> Vector:
        """Velocities of the arm's joints: float64 (6,), in radians per second."""
        return np.concatenate([joint.qvel for joint in self._joints])

    @property
    def fingertip(self) -> Vector:
        """Where the fingertip is: float64 (3,), in metres."""
        return np.array(self._tip.xpos)

    @property
    def depths(self) -> Vector:
        """How far each key is pushed down: float64 (10,), by digit, in metres."""
        return -np.concatenate([key.qpos for key in self._keys])
