"""A Fetch gripper above coloured blocks on a table, moving in a plane: the tasks. MuJoCo is imported when one is made.

`blocks` has all four blocks and no goal. A goal task has two, and an oracle: `blocks.red-left-of-green`.
"""

from functools import partial
from itertools import permutations

from freerein.types.sim import ActionSpec, Camera
from freerein_sim.worlds.blocks.relations import Goal, Relation
from freerein_sim.worlds.world import Task, World, WorldSpec

COLOURS = ("red", "green", "yellow", "blue")
CONTROL_DT_S = 0.04
GRIPPER_STEP_M = 0.05
FINGER_STEP_M = 0.02

_CAMERAS = tuple(Camera(name, 64, 64, 3) for name in ("front", "left", "tilt"))
_ACTION = ActionSpec(
    size=3,
    choices=0,
    names=("dy", "dz", "gripper"),
    unit="m",
    scale=(GRIPPER_STEP_M, GRIPPER_STEP_M, FINGER_STEP_M),
)
_DEMONSTRATION_STEPS = 150
_GOAL_STEPS = 100
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


def _spec(colours: tuple[str, ...], moved: tuple[str, ...], max_episode_steps: int) -> WorldSpec:
    return WorldSpec(
        cameras=_CAMERAS,
        action=_ACTION,
        control_dt_s=CONTROL_DT_S,
        skills=tuple(f"move-{colour}" for colour in moved),
        max_episode_steps=max_episode_steps,
        state_names=(
            "gripper.y",
            "gripper.z",
            "gripper.opening",
            *(f"{colour}.{part}" for colour in colours for part in _POSE),
        ),
    )


def _make(spec: WorldSpec, colours: tuple[str, ...], goal: Goal | None) -> World:
    from freerein_sim.worlds.blocks.simulation import Blocks

    return Blocks(spec, colours, goal)


def _goal_task(first: str, second: str, relation: Relation) -> Task:
    goal = Goal(first, relation, second)
    spec = _spec((first, second), (first,), _GOAL_STEPS)
    return Task(f"blocks.{goal.name}", "blocks", goal.text, spec, partial(_make, spec, (first, second), goal))


_FREE_PLAY = _spec(COLOURS, COLOURS, _DEMONSTRATION_STEPS)

TASKS = (
    Task("blocks", "blocks", "", _FREE_PLAY, partial(_make, _FREE_PLAY, COLOURS, None)),
    *(_goal_task(first, second, relation) for first, second in permutations(COLOURS, 2) for relation in Relation),
)
