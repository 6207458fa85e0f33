"""Tasks of the blocks world: a Fetch gripper and coloured blocks in a plane. MuJoCo is imported when one is made.

`blocks` has four blocks and no goal. A goal task, such as `blocks.red-left-of-green`, has two blocks and an oracle.
`blocks.scatter` shows two to four at random poses: images to train reward models from (dissertation, 4.2). With the
conditions `blocks-2` to `blocks-4` any of them shows as many; the others lie behind the wall.
"""

from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from itertools import permutations

from freerein_sim.worlds.blocks.goals import GOAL_RELATIONS, BlockGoal
from freerein_sim.worlds.blocks.predicates import landmarks_and_skills, relations, starts
from freerein_sim.worlds.blocks.relations import BlockRelation
from freerein_sim.worlds.blocks.spec import COLOURS, block_spec
from freerein_sim.worlds.blocks.variation import FREE_CONDITIONS, GOAL_CONDITIONS, SCATTER_CONDITIONS, Variation
from freerein_sim.worlds.conditions import Condition
from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.predicates import StatePredicate
from freerein_sim.worlds.world import TaskDefinition, World, WorldSpec

VERSION = 1
"""Version of the world; raised where it behaves differently."""

_DEMONSTRATION_STEPS, _GOAL_STEPS, _SCATTER_STEPS = 150, 100, 6


def _make_free(spec: WorldSpec, conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.blocks import expert, initial_states, simulation

    variation = Variation.of(conditions, blocks=len(COLOURS), fewest_blocks=len(COLOURS))
    if variation.blocks < len(COLOURS):
        spec = replace(spec, max_skills=variation.blocks)
    if variation.speed < 1:
        spec = replace(spec, max_episode_steps=round(spec.max_episode_steps / variation.speed))
    draw = partial(initial_states.line, count=variation.blocks)
    return simulation.BlocksWorld(spec, COLOURS, draw, variation, make_expert=expert.BlocksExpert)


def _make_scatter(spec: WorldSpec, conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.blocks import initial_states, simulation

    variation = Variation.of(conditions, blocks=len(COLOURS), fewest_blocks=2)
    draw = partial(initial_states.scatter, fewest=variation.fewest_blocks, most=variation.blocks)
    return simulation.BlocksWorld(spec, COLOURS, draw, variation)


def _make_goal(spec: WorldSpec, goal: BlockGoal, conditions: Collection[str] = ()) -> World:
    """Returns a world of a goal. With two blocks none other is simulated, which is faster."""
    check_mujoco_gl()
    from freerein_sim.worlds.blocks import expert, initial_states, simulation

    variation = Variation.of(conditions, blocks=2, fewest_blocks=2)
    colours = (goal.first, goal.second) if variation.blocks == 2 else COLOURS
    draw = partial(
        initial_states.pair,
        goal=goal,
        count=variation.blocks,
        interval_m=initial_states.UNSEEN_M if variation.is_start_unseen else initial_states.SEEN_M,
        begins=variation.begins,
    )
    return simulation.BlocksWorld(spec, colours, draw, variation, goal=goal, make_expert=expert.BlocksExpert)


def _task(
    name: str,
    spec: WorldSpec,
    make: Callable[..., World],
    predicates: tuple[StatePredicate, ...],
    conditions: tuple[Condition, ...],
    *,
    goal_text: str = "",
) -> TaskDefinition:
    predicates = landmarks_and_skills(spec.skills) + predicates
    return TaskDefinition(
        name, "blocks", goal_text, spec, make, predicates, conditions, version=VERSION, reward_free=not goal_text
    )


def _goal_task(first: str, second: str, relation: BlockRelation) -> TaskDefinition:
    goal, spec = BlockGoal(first, relation, second), block_spec((first,), _GOAL_STEPS)
    make = partial(_make_goal, spec, goal)
    return _task(f"blocks.{goal.name}", spec, make, starts(goal), GOAL_CONDITIONS, goal_text=goal.text)


_FREE, _SCATTER = block_spec(COLOURS, _DEMONSTRATION_STEPS), block_spec((), _SCATTER_STEPS)

TASKS = (
    _task("blocks", _FREE, partial(_make_free, _FREE), relations(), FREE_CONDITIONS),
    _task("blocks.scatter", _SCATTER, partial(_make_scatter, _SCATTER), relations(), SCATTER_CONDITIONS),
    *(_goal_task(first, second, relation) for first, second in permutations(COLOURS, 2) for relation in GOAL_RELATIONS),
)
