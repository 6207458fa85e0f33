"""Recipes: the skills that an episode executes, in order. Each task has a sampler of its own recipes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from freerein.errors import InvalidInput, must_be


class RecipeSampler(Protocol):
    """The recipes of a task; by default `RandomOrder`."""

    def lengths(self, skills: Sequence[str]) -> tuple[int, int]:
        """Returns the fewest and the most skills of a recipe out of these.

        Raises:
            InvalidInput: No recipe consists of these skills.
        """

    def draw(self, rng: np.random.Generator, skills: Sequence[str], *, fewest: int, most: int) -> tuple[str, ...]:
        """Returns a recipe.

        Args:
            rng: The generator. Where `fewest` equals `most`, the length takes nothing from it.
            skills: Different skills to choose from, for which `lengths` has an answer.
            fewest: Fewest skills, within `lengths`.
            most: Most skills, within `lengths`.
        """


@dataclass(frozen=True)
class RandomOrder:
    """Any skills, each at most once, in any order; their number is drawn uniformly.

    Attributes:
        most: Most skills of a recipe, for a task in which not all fit into an episode; 0 means all.
    """

    most: int = 0

    def lengths(self, skills: Sequence[str]) -> tuple[int, int]:
        """Returns 1 and the number of skills, or `most`; 0 and 0 without skills."""
        return min(1, len(skills)), min(len(skills), self.most or len(skills))

    def draw(self, rng: np.random.Generator, skills: Sequence[str], *, fewest: int, most: int) -> tuple[str, ...]:
        """Returns a random part of a random permutation."""
        number = rng.integers(fewest, most, endpoint=True)
        return tuple(skills[i] for i in rng.permutation(len(skills))[:number])


@dataclass(frozen=True)
class FixedOrder:
    """The same recipe in every episode.

    Attributes:
        recipe: Its skills, in order.
    """

    recipe: tuple[str, ...]

    def lengths(self, skills: Sequence[str]) -> tuple[int, int]:
        """Returns the number of its skills, twice. Raises InvalidInput where one of them may not be drawn."""
        if set(self.recipe).difference(skills):
            raise self._refusal(skills, "Leave `skills` out.")
        return len(self.recipe), len(self.recipe)

    def draw(self, rng: np.random.Generator, skills: Sequence[str], *, fewest: int, most: int) -> tuple[str, ...]:
        """Returns the recipe; draws nothing."""
        return self.recipe

    def check(self, recipe: Sequence[str]) -> None:
        """Raises InvalidInput for a recipe that is neither this one nor empty."""
        if recipe and tuple(recipe) != self.recipe:
            raise self._refusal(recipe, "Leave the recipe out.")

    def _refusal(self, skills: Sequence[str], hint: str) -> InvalidInput:
        return must_be("skills", f"all of the recipe {', '.join(self.recipe)}, in order", ", ".join(skills), hint=hint)


def check_one(recipe: Sequence[str], *, kind: str = "skill", begin: str = "anywhere") -> None:
    """Raises InvalidInput for a recipe of several skills, in a world whose episodes otherwise begin at `begin`."""
    if len(recipe) > 1:
        raise InvalidInput(
            f"A recipe of this world is one {kind}; got {', '.join(recipe)}.",
            field="skills",
            hint=f"Leave the recipe out to begin {begin}.",
        )


def recipe_lengths(
    sampler: RecipeSampler, skills: Sequence[str], *, fewest: int = 0, most: int = 0, limit: int = 0
) -> tuple[int, int]:
    """Returns the fewest and the most skills of a recipe that was asked for; 0 means the sampler's own bound.

    Args:
        sampler: The task's.
        skills: Skills to choose from.
        fewest: Fewest skills.
        most: Most skills.
        limit: Most skills that the world allows under its conditions; 0 for no limit.

    Raises:
        InvalidInput: No recipe has such a length.
    """
    least, greatest = sampler.lengths(skills)
    greatest = min(greatest, limit or greatest)
    chosen = fewest or least, most or greatest
    if not least <= chosen[0] <= chosen[1] <= greatest:
        raise InvalidInput(
            f"{least} <= `min_skills` <= `max_skills` <= {greatest} must hold, the bounds of a recipe; "
            f"got {fewest} and {most}.",
            field="max_skills",
            hint="0 means the task's own bound.",
        )
    return chosen
