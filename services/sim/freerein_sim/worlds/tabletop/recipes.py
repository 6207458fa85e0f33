"""Recipes of the tabletop world: a reach, and then one of the tasks."""

from collections.abc import Sequence

import numpy as np

from freerein.errors import InvalidInput
from freerein_sim.worlds.tabletop.spec import SPEC
from freerein_sim.worlds.tabletop.things import REACH, TASK_SKILLS
from freerein_sim.worlds.world import skill_indices


class ReachThenTask:
    """Recipes of a reach and then one other skill."""

    def lengths(self, skills: Sequence[str]) -> tuple[int, int]:
        """Returns 2 and 2."""
        if REACH not in skills or len(skills) < 2:
            raise InvalidInput(
                f"A recipe of this world is {REACH} and one other skill, but only {', '.join(skills)} may be drawn.",
                field="skills",
                hint=f"Leave `skills` out, or name {REACH} and one or more of {', '.join(TASK_SKILLS)}.",
            )
        return 2, 2

    def draw(self, rng: np.random.Generator, skills: Sequence[str], *, fewest: int, most: int) -> tuple[str, ...]:
        """Returns the reach and one of the others."""
        others = [skill for skill in skills if skill != REACH]
        return REACH, others[int(rng.integers(len(others)))]


def task_of(recipe: Sequence[str]) -> str:
    """Returns the skill that follows the reach, empty for an empty recipe. Raises InvalidInput for any other."""
    skill_indices(SPEC, recipe)
    if recipe and not (len(recipe) == 2 and recipe[0] == REACH and recipe[1] != REACH):
        raise InvalidInput(
            f"A recipe of this world is {REACH} and then one other skill; got {', '.join(recipe)}.",
            field="skills",
            hint="Leave the recipe out for any.",
        )
    return recipe[-1] if recipe else ""
