"""Tasks of the blocks world: a Fetch gripper and coloured blocks in a plane. MuJoCo is imported when one is made.

`blocks` has four blocks and no goal. A goal task, such as `blocks.red-left-of-green`, has two blocks and an oracle.
`blocks.scatter` shows two to four at random poses: images to train reward models from (dissertation, 4.2). With the
conditions `blocks-2` to `blocks-4` any of them shows as many; the others lie behind the wall.
"""

from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from itertools import permutations

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.blocks.goals import GOAL_RELATIONS, BlockGoal
from freerein_sim.worlds.blocks.predicates import BlockPredicates
from freerein_sim.worlds.blocks.relations import BlockRelation
from freerein_sim.worlds.blocks.variation import FREE_CONDITIONS, GOAL_CONDITIONS, SCATTER_CONDITIONS, Variation
from freerein_sim.worlds.conditions import Condition
from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.world import TaskDefinition, World, WorldSpec

VERSION = 1
"""Version of the world; raised where it behaves differently."""

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
_SCATTER_STEPS = 6
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


def _spec(moved: tuple[str, ...], max_episode_steps: int) -> WorldSpec:
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
            *(f"{colour}.{part}" for colour in COLOURS for part in _POSE),
        ),
    )


def _make_free(spec: WorldSpec, conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.blocks import initial_states, simulation

    variation = Variation.of(conditions, blocks=len(COLOURS), fewest_blocks=len(COLOURS))
    if variation.blocks < len(COLOURS):
        spec = replace(spec, max_skills=variation.blocks)
    if variation.speed < 1:
        spec = replace(spec, max_episode_steps=round(spec.max_episode_steps / variation.speed))
    draw = partial(initial_states.line, count=variation.blocks)
    return simulation.BlocksWorld(spec, COLOURS, draw, variation)


def _make_scatter(spec: WorldSpec, conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.blocks import initial_states, simulation

    variation = Variation.of(conditions, blocks=len(COLOURS), fewest_blocks=2)
    draw = partial(initial_states.scatter, fewest=variation.fewest_blocks, most=variation.blocks)
    return simulation.BlocksWorld(spec, COLOURS, draw, variation)


def _make_goal(spec: WorldSpec, goal: BlockGoal, conditions: Collection[str] = ()) -> World:
    """Returns a world of a goal. With two blocks none other is simulated, which is faster."""
    check_mujoco_gl()
    from freerein_sim.worlds.blocks import initial_states, simulation

    variation = Variation.of(conditions, blocks=2, fewest_blocks=2)
    colours = (goal.first, goal.second) if variation.blocks == 2 else COLOURS
    interval_m = initial_states.UNSEEN_M if variation.is_start_unseen else initial_states.SEEN_M
    draw = partial(
        initial_states.pair,
        goal=goal,
        count=variation.blocks,
        interval_m=interval_m,
        is_on_the_way=variation.is_start_on_the_way,
    )
    return simulation.BlocksWorld(spec, colours, draw, variation, goal=goal)


def _goal_task(first: str, second: str, relation: BlockRelation) -> TaskDefinition:
    goal = BlockGoal(first, relation, second)
    spec = _spec((first,), _GOAL_STEPS)
    judged = BlockPredicates(spec)
    predicates = judged.landmarks_and_skills() + judged.starts(goal)
    make = partial(_make_goal, spec, goal)
    name = f"blocks.{goal.name}"
    return TaskDefinition(name, "blocks", goal.text, spec, make, predicates, GOAL_CONDITIONS, version=VERSION)


def _free_task(
    name: str, spec: WorldSpec, make: Callable[..., World], conditions: tuple[Condition, ...]
) -> TaskDefinition:
    judged = BlockPredicates(spec)
    predicates = judged.landmarks_and_skills() + judged.relations()
    return TaskDefinition(name, "blocks", "", spec, partial(make, spec), predicates, conditions, version=VERSION)


TASKS = (
    _free_task("blocks", _spec(COLOURS, _DEMONSTRATION_STEPS), _make_free, FREE_CONDITIONS),
    _free_task("blocks.scatter", _spec((), _SCATTER_STEPS), _make_scatter, SCATTER_CONDITIONS),
    *(_goal_task(first, second, relation) for first, second in permutations(COLOURS, 2) for relation in GOAL_RELATIONS),
)
