"""Tasks of the push world: Sawyer's hand pushes a puck close to another. MuJoCo is imported when one is made.

`push` is the dissertation's task, "a blue puck close to a yellow puck". `push.red-close-to-green` and its like have
other colours. `push.scatter` shows two or three pucks, and often blocks and a tray, anywhere on the table: images to
train reward models from, in which all criteria of table 4.1 occur.
"""

from collections.abc import Collection
from functools import partial
from itertools import permutations

from freerein_sim.worlds.conditions import CAMERA_CONDITIONS, LIGHT_CONDITIONS
from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.push.predicates import landmarks, relations, skills
from freerein_sim.worlds.push.spec import RECIPE, push_spec
from freerein_sim.worlds.push.things import EVERYTHING, PUCKS, Thing
from freerein_sim.worlds.world import TaskDefinition, World, WorldSpec

VERSION = 2
"""Version of the world; raised where it behaves differently."""

_GOAL_STEPS, _SCATTER_STEPS = 100, 6
_CONDITIONS = (*LIGHT_CONDITIONS, *CAMERA_CONDITIONS)


def _make_goal(spec: WorldSpec, things: tuple[Thing, Thing], conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.push import expert, initial_states, simulation

    make_expert = expert.PushExpert
    return simulation.PushWorld(spec, things, initial_states.pair, make_expert=make_expert, conditions=conditions)


def _make_scatter(spec: WorldSpec, conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.push import initial_states, simulation

    return simulation.PushWorld(spec, EVERYTHING, initial_states.scatter, conditions=conditions)


def _goal_task(first: Thing, second: Thing) -> TaskDefinition:
    things = (first, second)
    name = "push" if things == _DISSERTATIONS else f"push.{first.colour}-close-to-{second.colour}"
    spec = push_spec(things, skills=RECIPE.recipe, max_episode_steps=_GOAL_STEPS)
    predicates = (*landmarks(spec, things), *skills(spec, things), *relations(spec, things))
    goal_text = f"{first.noun} close to {second.noun}"
    make = partial(_make_goal, spec, things)
    return TaskDefinition(name, "push", goal_text, spec, make, predicates, _CONDITIONS, RECIPE, VERSION)


def _scatter_task() -> TaskDefinition:
    spec = push_spec(EVERYTHING, skills=(), max_episode_steps=_SCATTER_STEPS)
    predicates = (*landmarks(spec, EVERYTHING), *relations(spec, EVERYTHING))
    make = partial(_make_scatter, spec)
    return TaskDefinition(
        "push.scatter", "push", "", spec, make, predicates, _CONDITIONS, version=VERSION, reward_free=True
    )


_DISSERTATIONS = (Thing("puck", "blue"), Thing("puck", "yellow"))
TASKS = (*(_goal_task(*pair) for pair in permutations(PUCKS, 2)), _scatter_task())
