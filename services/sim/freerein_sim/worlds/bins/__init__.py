"""The bins world: a Sawyer puts groceries from the left bin into their compartments of the right one.

The dissertation's RoboSuite task (section 2.4). All four groceries lie in the left bin in every episode. MuJoCo is
imported when a world is made.
"""

from collections.abc import Collection
from dataclasses import replace
from functools import partial

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.bins.durations import Durations, EvenDurations, UnevenDurations
from freerein_sim.worlds.bins.layout import GROCERIES
from freerein_sim.worlds.bins.predicates import BinPredicates
from freerein_sim.worlds.conditions import LIGHT_CONDITIONS, light_scale
from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.world import TaskDefinition, World, WorldSpec

VERSION = 1
"""Version of the world; raised where it behaves differently."""

CONTROL_DT_S = 0.25
GRIPPER_STEP_M = 0.25
FINGER_STEP_M = 0.0325

_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")

SPEC = WorldSpec(
    cameras=(Camera("agentview", 128, 128, 3),),
    action=ActionSpec(
        size=4,
        choices=0,
        names=("dx", "dy", "dz", "gripper"),
        unit="m",
        scale=(GRIPPER_STEP_M, GRIPPER_STEP_M, GRIPPER_STEP_M, FINGER_STEP_M),
    ),
    control_dt_s=CONTROL_DT_S,
    skills=tuple(f"move-{each.name}" for each in GROCERIES),
    max_episode_steps=100,
    state_names=(
        *(f"gripper.{part}" for part in ("x", "y", "z", "opening")),
        *(f"{each.name}.{part}" for each in GROCERIES for part in _POSE),
    ),
)


def _make(spec: WorldSpec, durations: Durations, conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.bins import simulation

    return simulation.BinsWorld(spec, durations, light=light_scale(conditions))


def _task(name: str, spec: WorldSpec, durations: Durations) -> TaskDefinition:
    make, predicates = partial(_make, spec, durations), BinPredicates(spec).all()
    return TaskDefinition(name, "bins", "", spec, make, predicates, LIGHT_CONDITIONS, version=VERSION)


TASKS = (
    _task("bins", SPEC, EvenDurations()),
    _task("bins.uneven", replace(SPEC, max_episode_steps=500), UnevenDurations()),
)
"""In `bins.uneven` some moves of a demonstration take many times as long as others; all else is as in `bins`."""
