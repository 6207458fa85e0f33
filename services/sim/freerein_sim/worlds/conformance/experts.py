"""Checks of a task's scripted expert."""

from collections.abc import Iterator, Sequence
from contextlib import closing

import numpy as np

from freerein_sim.worlds.conformance.assertions import require
from freerein_sim.worlds.conformance.rollouts import SEED, STEPS, Demonstration, act_randomly, demonstrate
from freerein_sim.worlds.episodes import record_episode
from freerein_sim.worlds.world import TaskDefinition, World, expert_of

_TRIES = 3
"""Attempts at a recipe; experts may stumble now and then."""


def has_an_expert_that_succeeds(task: TaskDefinition) -> None:
    """The expert executes recipes in order and in time, and completes its skills; the oracle sees the goal, if any."""
    if not task.spec.has_expert:
        return
    with closing(task.make()) as world:
        for recipe, shown in _demonstrations(task, world):
            labels = shown.episode.labels
            order = [task.spec.skills[label] for label in labels[np.flatnonzero(np.diff(labels, prepend=-2))]]
            require(tuple(order) == recipe, "Labels follow the recipe.")
            require(not task.goal_text or world.truth().success, "The oracle sees the goal that the expert reached.")
            _check_completed(task, recipe, shown)
        world.reset(np.random.default_rng(SEED), recipe=recipe)
        expert = expert_of(world)(recipe, np.random.default_rng(SEED))
        record_episode(world, expert, cameras=(), max_steps=1)
        require(not expert.succeeded(), "An expert that has only begun has not succeeded.")


def has_an_expert_that_survives_any_state(task: TaskDefinition) -> None:
    """The expert acts within the spec from a random state, too."""
    if not task.spec.has_expert:
        return
    with closing(task.make()) as world:
        rng = np.random.default_rng(SEED)
        recipe = _longest_recipe(task, rng)
        world.reset(rng, recipe=recipe)
        for _ in act_randomly(world):
            pass
        record_episode(world, expert_of(world)(recipe, rng), cameras=(), max_steps=5 * STEPS)


def has_an_expert_of_its_own_recipe(task: TaskDefinition) -> None:
    """An expert without skills executes what the episode requires, or chooses."""
    if not task.spec.has_expert:
        return
    with closing(task.make()) as world:
        rng = np.random.default_rng(SEED)
        succeeded = any(demonstrate(world, (), rng).episode.success for _ in range(_TRIES))
        require(succeeded, "The expert succeeds at the recipe of the episode.")


def _check_completed(task: TaskDefinition, recipe: Sequence[str], shown: Demonstration) -> None:
    """`completed/SKILL` holds where the expert ends a skill, not where it begins, and of no other skill."""
    skills = task.spec.skills
    completed = {each.name.removeprefix("completed/"): each for each in task.predicates if "completed/" in each.name}
    require(set(completed) == set(skills), "There is a predicate `completed/SKILL` for each skill.")
    for skill, states in shown.attempts():
        holds = completed[skills[skill]].holds(states)[0]
        require(bool(holds[-1]) and not holds[0], "A skill is completed at the end of its attempt, not before.")
    last = [bool(completed[skill].holds(shown.states[None])[0, -1]) for skill in skills if skill not in recipe]
    require(not any(last), "No other skill is completed.")


def _longest_recipe(task: TaskDefinition, rng: np.random.Generator) -> tuple[str, ...]:
    _, most = task.recipes.lengths(task.spec.skills)
    return task.recipes.draw(rng, task.spec.skills, fewest=most, most=most)


def _demonstrations(task: TaskDefinition, world: World) -> Iterator[tuple[tuple[str, ...], Demonstration]]:
    """Yields a recipe of the fewest skills and one of the most, each with a success; the world is where that ended."""
    rng = np.random.default_rng(SEED)
    for length in task.recipes.lengths(task.spec.skills):
        recipe = task.recipes.draw(rng, task.spec.skills, fewest=length, most=length)
        for _ in range(_TRIES):
            shown = demonstrate(world, recipe, rng)
            if shown.episode.success:
                break
        require(shown.episode.success, f"The expert succeeds within {_TRIES} tries at {', '.join(recipe)}.")
        yield recipe, shown
