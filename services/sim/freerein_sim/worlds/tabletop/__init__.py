"""Tasks of the tabletop world, a procedural substitute for MIME's protocol. MuJoCo is imported when one is made.

MIME's videos show a reach and then one of several tasks with an object. Here a hand reaches for a cup, a spoon, a
block, a ball or a sponge, and then pours, stirs, stacks, places it in a box, or wipes. In `tabletop` everything is on
the table whatever follows. In `tabletop.only-own-objects`, as in MIME, only what the task uses is: every frame tells
the task, so that tags cannot tell where the reach ends.
"""

from functools import partial

from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.tabletop.predicates import PREDICATES
from freerein_sim.worlds.tabletop.recipes import ReachThenTask
from freerein_sim.worlds.tabletop.spec import SPEC
from freerein_sim.worlds.world import TaskDefinition, World

VERSION = 1
"""Version of the world; raised where it behaves differently."""


def _make(*, only_own: bool) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.tabletop import demonstrator, simulation

    return simulation.TabletopWorld(SPEC, demonstrator.Demonstrator, only_own=only_own)


def _task(name: str, *, only_own: bool) -> TaskDefinition:
    make = partial(_make, only_own=only_own)
    return TaskDefinition(
        name, "tabletop", "", SPEC, make, PREDICATES, recipes=ReachThenTask(), version=VERSION, reward_free=True
    )


TASKS = (_task("tabletop", only_own=False), _task("tabletop.only-own-objects", only_own=True))
