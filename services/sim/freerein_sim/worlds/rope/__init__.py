"""The dissertation's rope (chapter 3, appendix A): pick and place from above, in MuJoCo.

One action picks the rope up at a place, carries it by a displacement and lays it down. MuJoCo is imported when a world
is made.
"""

from collections.abc import Collection
from typing import cast

import numpy as np

from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.recipes import RandomOrder
from freerein_sim.worlds.rope.predicates import MEASURES, PREDICATES
from freerein_sim.worlds.rope.spec import CONDITIONS, SPEC
from freerein_sim.worlds.world import ScriptedPolicy, TaskDefinition, UnsavedWorld, World

VERSION = 1
"""Version of the world; raised where it behaves differently."""


def _make(conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.rope import expert, simulation

    return simulation.RopeWorld(expert.RopeExpert, conditions)


def _explore(world: UnsavedWorld, rng: np.random.Generator) -> ScriptedPolicy:
    from freerein_sim.worlds.rope import explorer, simulation

    return explorer.RandomDisplacements(cast(simulation.RopeWorld, world), rng)


TASKS = (
    TaskDefinition(
        "rope",
        "rope",
        "",
        SPEC,
        _make,
        PREDICATES,
        CONDITIONS,
        RandomOrder(most=1),
        version=VERSION,
        explorer=_explore,
        measures=MEASURES,
        reward_free=True,
    ),
)
