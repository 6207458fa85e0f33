"""The scripted demonstrator of the tabletop world: reaches for a thing and then does its task, at a person's speed.

How long an episode takes, and which share of it the reach is, are drawn first and do not depend on the task.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein_sim.worlds.tabletop.motions import Pose
from freerein_sim.worlds.tabletop.plans import TASK_PLANS, plan_reach
from freerein_sim.worlds.tabletop.predicates import COMPLETED
from freerein_sim.worlds.tabletop.recipes import task_of
from freerein_sim.worlds.tabletop.simulation import TabletopWorld
from freerein_sim.worlds.tabletop.spec import HAND_STEP, OPENING_STEP_M
from freerein_sim.worlds.tabletop.things import REACH, THINGS, Thing, thing_of
from freerein_sim.worlds.world import LabelledAction

STEPS = (80, 100)
REACH_SHARE = (0.15, 0.85)
_TREMOR = np.array([0.0012, 0.0012, 0.0012, 0.01, 0.01, 0.0])
"""Standard deviation of the set-point, as a pose."""


class Demonstrator:
    """Executes a reach and then the task of a thing, that of the episode without skills, using the true state.

    Attributes:
        steps: Timesteps of the demonstration.
        reach_steps: Those of its reach.
    """

    def __init__(self, world: TabletopWorld, skills: Sequence[str], rng: np.random.Generator) -> None:
        self._world = world
        self._thing = _wanted(world, skills)
        self._rng = rng
        self.steps = int(rng.integers(*STEPS, endpoint=True))
        least, most = np.ceil(REACH_SHARE[0] * self.steps), np.floor(REACH_SHARE[1] * self.steps)
        self.reach_steps = int(np.clip(np.rint(rng.uniform(*REACH_SHARE) * self.steps), least, most))
        self._poses: Pose = np.empty((0, 6))
        self._states: list[npt.NDArray[np.float64]] = []

    def act(self) -> LabelledAction | None:
        """Returns the action towards the next pose of the plan; plans when a skill begins."""
        step = len(self._states)
        if step == self.steps:
            return None
        self._states.append(self._world.truth().state)
        if step == 0:
            self._poses = plan_reach(self._world, self._thing, self._rng, self.reach_steps).poses(self.reach_steps)
        elif step == self.reach_steps:
            steps = self.steps - self.reach_steps
            movement = TASK_PLANS[self._thing.task](self._world, self._rng, steps)
            self._poses = np.concatenate([self._poses, movement.poses(steps)])
        target = self._poses[step] + _TREMOR * self._rng.standard_normal(len(_TREMOR))
        change = np.clip((target - self._world.set_point) / (*HAND_STEP, OPENING_STEP_M), -1, 1)
        skill = REACH if step < self.reach_steps else self._thing.task
        return LabelledAction(change.astype(np.float32), self._world.spec.skills.index(skill))

    def succeeded(self) -> bool:
        """Returns whether both skills were completed in the last state in which it acted."""
        if not self._states:
            return False
        states = np.stack(self._states)[None]
        return all(COMPLETED[skill](states)[0, -1] for skill in (REACH, self._thing.task))


def _wanted(world: TabletopWorld, skills: Sequence[str]) -> Thing:
    """Returns the thing that a recipe uses. Raises InvalidInput where it is not on show."""
    task = task_of(skills)
    thing = thing_of(task) if task else world.thing
    shown = [each.task for each in THINGS if world.is_on_show(each)]
    if thing.task not in shown:
        raise InvalidInput(
            f"The objects of the recipe must be on show; only those of {', '.join(shown)} are.",
            field="skills",
            hint="Reset the environment with the recipe, or leave it out.",
        )
    return thing
