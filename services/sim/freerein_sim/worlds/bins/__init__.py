"""The bins world: a Sawyer puts groceries from the left bin into their compartments of the right one.

The dissertation's RoboSuite task (section 2.4). All four groceries lie in the left bin in every episode. MuJoCo is
imported when a world is made.
"""

from collections.abc import Collection
from dataclasses import replace
from functools import partial

from freerein_sim.worlds.bins.durations import DrawTempos, even_tempos, uneven_tempos
from freerein_sim.worlds.bins.predicates import PREDICATES
from freerein_sim.worlds.bins.spec import SPEC
from freerein_sim.worlds.conditions import LIGHT_CONDITIONS, light_scale
from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.world import TaskDefinition, World, WorldSpec

VERSION = 1
"""Version of the world; raised where it behaves differently."""


def _make(spec: WorldSpec, draw_tempos: DrawTempos, conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.bins import expert, scene, simulation

    make_expert = partial(expert.BinsExpert, draw_tempos=draw_tempos)
    return simulation.BinsWorld(spec, scene.build(light=light_scale(conditions)), make_expert)


def _task(name: str, spec: WorldSpec, draw_tempos: DrawTempos) -> TaskDefinition:
    make = partial(_make, spec, draw_tempos)
    return TaskDefinition(name, "bins", "", spec, make, PREDICATES, LIGHT_CONDITIONS, version=VERSION, reward_free=True)


TASKS = (
    _task("bins", SPEC, even_tempos),
    _task("bins.uneven", replace(SPEC, max_episode_steps=500), uneven_tempos),
)
"""In `bins.uneven` some moves of a demonstration take many times as long as others; all else is as in `bins`."""
