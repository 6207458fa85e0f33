from collections import Counter

import numpy as np
import pytest

from freerein.errors import InvalidInput
from freerein_sim.worlds.recipes import RandomOrder, recipe_lengths

SKILLS = ("pick", "push", "turn")


def test_every_recipe_of_a_length_is_drawn_as_often() -> None:
    rng = np.random.default_rng(0)
    drawn = Counter(RandomOrder().draw(rng, SKILLS, fewest=1, most=3) for _ in range(6000))

    assert {len(recipe): count for recipe, count in drawn.items() if count < 100} == {}
    assert Counter(map(len, drawn)) == {1: 3, 2: 6, 3: 6}
    lengths = np.array([sum(count for recipe, count in drawn.items() if len(recipe) == n) for n in (1, 2, 3)])
    assert np.abs(lengths - 2000).max() < 150


def test_a_given_length_takes_nothing_from_the_generator() -> None:
    rng, twin = np.random.default_rng(0), np.random.default_rng(0)

    recipe = RandomOrder().draw(rng, SKILLS, fewest=2, most=2)

    assert recipe == tuple(SKILLS[i] for i in twin.permutation(3)[:2])


@pytest.mark.parametrize(
    ("asked", "expected"),
    [({}, (1, 2)), ({"fewest": 2}, (2, 2)), ({"most": 1}, (1, 1)), ({"limit": 1}, (1, 1)), ({"limit": 3}, (1, 2))],
)
def test_a_length_that_is_not_asked_for_is_the_tasks(asked: dict[str, int], expected: tuple[int, int]) -> None:
    assert recipe_lengths(RandomOrder(most=2), SKILLS, **asked) == expected


@pytest.mark.parametrize("asked", [{"most": 3}, {"fewest": 3}, {"fewest": 2, "most": 1}, {"most": 2, "limit": 1}])
def test_a_length_that_no_recipe_has_is_refused(asked: dict[str, int]) -> None:
    with pytest.raises(InvalidInput, match="must hold"):
        recipe_lengths(RandomOrder(most=2), SKILLS, **asked)
