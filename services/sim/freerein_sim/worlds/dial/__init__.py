"""The dissertation's dial world (section 2.4): a torque-driven Jaco arm presses number keys. Imports no simulator.

Skill `press-4` presses the key 4. All keys are in place in every episode, and the arm begins near one pose, so that the
scene does not reveal which skills occur. The drives of the arm compensate gravity.
"""

from collections.abc import Collection
from dataclasses import replace
from functools import partial

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.conditions import LIGHT_CONDITIONS, light_scale
from freerein_sim.worlds.dial.durations import Durations, EvenDurations, UnevenDurations
from freerein_sim.worlds.dial.keypad import DIGITS
from freerein_sim.worlds.dial.predicates import completed
from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.recipes import RandomOrder
from freerein_sim.worlds.world import TaskDefinition, World, WorldSpec

VERSION = 1
"""Version of the world; raised where it behaves differently."""

CONTROL_DT_S = 0.04
TORQUE_NM = (30.0, 30.0, 30.0, 7.0, 7.0, 7.0)
"""Greatest torque of each joint; the arm's data sheet has 30.5 and 6.8."""

_JOINTS = tuple(f"joint-{number}" for number in range(1, 7))

SPEC = WorldSpec(
    cameras=(Camera("front", 112, 112, 1),),
    action=ActionSpec(size=len(_JOINTS), choices=0, names=_JOINTS, unit="N m", scale=TORQUE_NM),
    control_dt_s=CONTROL_DT_S,
    skills=tuple(f"press-{digit}" for digit in DIGITS),
    max_episode_steps=100,
    state_names=(
        *(f"{joint}.angle" for joint in _JOINTS),
        *(f"fingertip.{axis}" for axis in "xyz"),
        *(f"key-{digit}.depth" for digit in DIGITS),
    ),
)


def _make(spec: WorldSpec, durations: Durations, conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.dial import scene
    from freerein_sim.worlds.dial.simulation import DialWorld

    return DialWorld(spec, scene.build(light=light_scale(conditions)), durations)


RECIPES = RandomOrder(most=5)
"""More keys do not fit into an episode."""


def _task(name: str, spec: WorldSpec, durations: Durations) -> TaskDefinition:
    make = partial(_make, spec, durations)
    return TaskDefinition(name, "dial", "", spec, make, completed(spec), LIGHT_CONDITIONS, RECIPES, VERSION)


TASKS = (
    _task("dial", SPEC, EvenDurations()),
    _task("dial.uneven", replace(SPEC, max_episode_steps=500), UnevenDurations()),
)
"""In `dial.uneven` some presses of a demonstration take many times as long as others; all else is as in `dial`."""
