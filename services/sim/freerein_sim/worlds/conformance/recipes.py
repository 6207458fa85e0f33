"""Checks of a task's recipes."""

from contextlib import closing

import numpy as np

from freerein_sim.worlds.conformance.assertions import require, require_refusal
from freerein_sim.worlds.conformance.rollouts import SEED
from freerein_sim.worlds.recipes import recipe_lengths
from freerein_sim.worlds.world import TaskDefinition

_RECIPES_PER_SKILL = 30
_TRIED = 10


def draws_recipes_that_it_accepts(task: TaskDefinition) -> None:
    """Recipes are of the task's skills and lengths, cover both, and the world accepts them; no longer one is drawn."""
    skills, sampler = task.spec.skills, task.recipes
    fewest, most = sampler.lengths(skills)
    require(0 <= fewest <= most <= len(skills), "The lengths of recipes are bounded by the number of skills.")
    require_refusal(lambda: recipe_lengths(sampler, skills, most=most + 1), "A longer recipe is refused.")
    if not skills:
        return
    drawn, again = (
        [sampler.draw(rng, skills, fewest=fewest, most=most) for _ in range(_RECIPES_PER_SKILL * len(skills))]
        for rng in (np.random.default_rng(SEED), np.random.default_rng(SEED))
    )
    require(drawn == again, "Equal seeds give equal recipes.")
    require({len(recipe) for recipe in drawn} == set(range(fewest, most + 1)), "Recipes have all lengths.")
    require({skill for recipe in drawn for skill in recipe} == set(skills), "Recipes are of the task's skills, of all.")
    for recipe in drawn[:_TRIED]:
        rng, length = np.random.default_rng(SEED), len(recipe)
        part = sampler.draw(rng, recipe, fewest=length, most=length)
        require(sorted(part) == sorted(recipe), "A recipe out of the skills of a recipe has the same skills.")
    with closing(task.make()) as world:
        for recipe in drawn[:_TRIED]:
            world.reset(np.random.default_rng(SEED), recipe=recipe)
