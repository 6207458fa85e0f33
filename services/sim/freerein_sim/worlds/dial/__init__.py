"""The dissertation's dial world (section 2.4): a torque-driven Jaco arm presses number keys. Imports no simulator.

Skill `press-4` presses the key 4. All keys are in place in every episode, and the arm begins near one pose, so that the
scene does not reveal which skills occur. The drives of the arm compensate gravity.
"""

from collections.abc import Collection
from dataclasses import replace
from functools import partial

from freerein_sim.worlds.conditions import LIGHT_CONDITIONS, light_scale
from freerein_sim.worlds.dial.durations import EVEN, UNEVEN, Durations
from freerein_sim.worlds.dial.predicates import PREDICATES
from freerein_sim.worlds.dial.spec import RECIPES, SPEC
from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.world import TaskDefinition, World, WorldSpec

VERSION = 1
"""Version of the world; raised where it behaves differently."""


def _make(spec: WorldSpec, durations: Durations, conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.dial import expert, scene, simulation

    make_expert = partial(expert.DialExpert, durations=durations)
    return simulation.DialWorld(spec, scene.build(light=light_scale(conditions)), make_expert)


def _task(name: str, spec: WorldSpec, durations: Durations) -> TaskDefinition:
    make = partial(_make, spec, durations)
    return TaskDefinition(
        name, "dial", "", spec, make, PREDICATES, LIGHT_CONDITIONS, RECIPES, VERSION, reward_free=True
    )


TASKS = (
    _task("dial", SPEC, EVEN),
    _task("dial.uneven", replace(SPEC, max_episode_steps=500), UNEVEN),
)
"""In `dial.uneven` some presses of a demonstration take many times as long as others; all else is as in `dial`."""
