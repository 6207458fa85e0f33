"""Tasks of the tabletop world, a procedural substitute for MIME's protocol. MuJoCo is imported when one is made.

MIME's videos show a reach and then one of several tasks with an object. Here a hand reaches for a cup, a spoon, a
block, a ball or a sponge, and then pours, stirs, stacks, places it in a box, or wipes. In `tabletop` everything is on
the table whatever follows. In `tabletop.only-own-objects`, as in MIME, only what the task uses is: every frame tells
the task, so that tags cannot tell where the reach ends.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.tabletop.predicates import PREDICATES, STATE_NAMES
from freerein_sim.worlds.tabletop.things import REACH, TASK_SKILLS
from freerein_sim.worlds.world import TaskDefinition, World, WorldSpec

VERSION = 1
"""Version of the world; raised where it behaves differently."""

CONTROL_DT_S = 0.1
HAND_STEP = (0.15, 0.15, 0.15, 0.8, 0.8)
OPENING_STEP_M = 0.06

SPEC = WorldSpec(
    cameras=(Camera("front", 120, 320, 1),),
    action=ActionSpec(
        size=6,
        choices=0,
        names=("dx", "dy", "dz", "dpitch", "droll", "gripper"),
        unit="m, rad",
        scale=(*HAND_STEP, OPENING_STEP_M),
    ),
    control_dt_s=CONTROL_DT_S,
    skills=(REACH, *TASK_SKILLS),
    max_episode_steps=100,
    state_names=STATE_NAMES,
)


class ReachThenTask:
    """Recipes of a reach and then one other skill."""

    def lengths(self, skills: Sequence[str]) -> tuple[int, int]:
        """Returns 2 and 2."""
        if REACH not in skills or len(skills) < 2:
            raise InvalidInput(
                f"A recipe of this world is {REACH} and one other skill, but only {', '.join(skills)} may be drawn.",
                field="skills",
                hint=f"Leave `skills` out, or name {REACH} and one or more of {', '.join(TASK_SKILLS)}.",
            )
        return 2, 2

    def draw(self, rng: np.random.Generator, skills: Sequence[str], *, fewest: int, most: int) -> tuple[str, ...]:
        """Returns the reach and one of the others."""
        others = [skill for skill in skills if skill != REACH]
        return REACH, others[int(rng.integers(len(others)))]


def _make(*, only_own: bool) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.tabletop.simulation import TabletopWorld

    return TabletopWorld(SPEC, only_own=only_own)


def _task(name: str, *, only_own: bool) -> TaskDefinition:
    make = partial(_make, only_own=only_own)
    return TaskDefinition(name, "tabletop", "", SPEC, make, PREDICATES, recipes=ReachThenTask(), version=VERSION)


TASKS = (_task("tabletop", only_own=False), _task("tabletop.only-own-objects", only_own=True))
