"""The push world in MuJoCo."""

from collections.abc import Collection, Sequence

import numpy as np

from freerein_sim.worlds.camera_moves import camera_move
from freerein_sim.worlds.conditions import light_scale
from freerein_sim.worlds.mujoco_world import MakeWorldExpert, MujocoWorld
from freerein_sim.worlds.push import scene
from freerein_sim.worlds.push.criteria import Place, is_close
from freerein_sim.worlds.push.initial_states import InitialStateSampler
from freerein_sim.worlds.push.predicates import is_shown
from freerein_sim.worlds.push.spec import CONTROL_DT_S, HAND_STEP_M, RECIPE
from freerein_sim.worlds.push.things import Thing
from freerein_sim.worlds.world import Action, GroundTruth, StepResult, WorldSpec, check_actions, skill_indices

_SUBSTEPS = round(CONTROL_DT_S / scene.TIMESTEP_S)
_LEAD_M = 0.03


class PushWorld(MujocoWorld):
    """A hand with closed fingers, and things on a table.

    Args:
        spec: The task's spec.
        things: All things of the scene. With an expert the goal is that the first comes close to the second.
        draw_initial_state: Draws initial states.
        make_expert: Makes its experts; None for a task without a goal.
        conditions: Of light and cameras.

    Attributes:
        things: As given.
    """

    def __init__(
        self,
        spec: WorldSpec,
        things: tuple[Thing, ...],
        draw_initial_state: InitialStateSampler,
        *,
        make_expert: MakeWorldExpert | None = None,
        conditions: Collection[str] = (),
    ) -> None:
        built = scene.build(things, light=light_scale(conditions))
        super().__init__(spec, built, make_expert, camera_move(conditions, cameras=len(scene.CAMERAS)))
        self.things = things
        self._draw_initial_state = draw_initial_state

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Draws the initial state, on which a recipe has no effect."""
        skill_indices(self.spec, recipe)
        RECIPE.check(recipe)
        self._simulation.reset(rng)
        start = self._draw_initial_state(rng)
        for thing, place, yaw in zip(self.things, start.places, start.yaws_rad, strict=True):
            self._data.joint(thing.name).qpos = (*place, np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
            if not is_shown(place):
                body = self._data.body(thing.name)
                body.xfrc_applied[:3] = -self._data.model.opt.gravity * self._data.model.body(thing.name).mass
        for name, at in zip(scene.HAND_JOINTS, start.hand, strict=True):
            self._data.joint(name).qpos = at
        self._data.act[:] = start.hand[:2]
        self._data.ctrl[2] = start.hand[2]
        self._simulation.refresh()

    def step(self, action: Action) -> StepResult:
        """Moves the servos' set-points by the action while it simulates one control step.

        The lead of the set-point over the hand is limited, so that a blocked hand does not wind up.
        """
        check_actions(self.spec.action, action)
        here = self.hand[:2]
        self._data.act[:] = np.clip(self._data.act, here - _LEAD_M, here + _LEAD_M)
        self._data.ctrl[:2] = HAND_STEP_M / CONTROL_DT_S * action
        if self._simulation.step(_SUBSTEPS):
            return StepResult(terminated=True, diverged=True)
        self._simulation.refresh()
        return StepResult(terminated=any(self._is_off_the_table(thing) for thing in self.things))

    def truth(self) -> GroundTruth:
        """Returns the poses of hand and things, and whether the goal holds."""
        success = self.expert is not None and bool(is_close(*(self.place(thing) for thing in self.things[:2])))
        state = np.concatenate([self.hand, *(self._data.joint(thing.name).qpos for thing in self.things)])
        return GroundTruth(state, float(success), success)

    @property
    def hand(self) -> Place:
        """Middle between the fingertips, float64 (3,)."""
        return np.concatenate([self._data.joint(name).qpos for name in scene.HAND_JOINTS])

    @property
    def set_point(self) -> Place:
        """Place to which the servos bring the hand: float64 (2,), x and y."""
        return np.array(self._data.act)

    def place(self, thing: Thing) -> Place:
        """Returns the centre of a thing, float64 (3,)."""
        return np.array(self._data.joint(thing.name).qpos[:3])

    def _is_off_the_table(self, thing: Thing) -> bool:
        place = self.place(thing)
        return bool(is_shown(place) and (np.abs(place[:2]) > scene.TABLE_HALF_M).any())
