import numpy as np
import numpy.typing as npt
import pytest

from freerein.cli.demo import recipes
from freerein.cli.demo.recipes import Outcome, Turn

TABLE, HELD, ON_TOP = 0.025, 0.12, 0.075


def states(*places: dict[str, tuple[float, float]]) -> npt.NDArray[np.float64]:
    """Returns states in which blocks are where they were unless it says else: (y, z) by colour."""
    here = {colour: (0.1 * place, TABLE) for place, colour in enumerate(recipes.COLOURS)}
    found = []
    for changed in places:
        here = {**here, **changed}
        poses = [[0, y, z, 1, 0, 0, 0] for y, z in here.values()]
        found.append([0, 0.2, 0.06, *np.ravel(poses)])
    return np.array(found)


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        ([{}, {"red": (0.0, HELD)}, {"red": (-0.05, TABLE)}], Outcome(lifted=True, completed=True)),
        ([{}, {"red": (0.0, HELD)}, {"red": (0.21, ON_TOP)}], Outcome(lifted=True, completed=True)),
        ([{}, {"red": (0.0, HELD)}, {"red": (-0.05, HELD)}], Outcome(lifted=True, completed=False)),
        ([{}, {"red": (0.0, HELD)}, {"red": (-0.05, ON_TOP)}], Outcome(lifted=True, completed=False)),
        ([{}, {"red": (0.0, HELD)}, {"red": (0.02, TABLE)}], Outcome(lifted=True, completed=False)),
        (
            [{}, {"red": (0.0, HELD)}, {"red": (-0.05, TABLE), "blue": (0.33, TABLE)}],
            Outcome(lifted=True, completed=False),
        ),
        ([{}, {"red": (-0.05, TABLE)}], Outcome(lifted=False, completed=False)),
        ([{}], Outcome(lifted=False, completed=False)),
    ],
    ids=["put down", "stacked", "held", "in the air", "put back", "another pushed", "pushed", "nothing"],
)
def test_a_skill_is_completed_when_its_block_was_lifted_and_rests_elsewhere(
    places: list[dict[str, tuple[float, float]]], expected: Outcome
) -> None:
    assert recipes.judge(Turn("move-red", states(*places))) == expected


def test_each_turn_ends_in_the_state_in_which_the_next_begins() -> None:
    seen = states(*[{"red": (0.01 * t, TABLE)} for t in range(6)])
    found = recipes.turns(["move-red", "move-blue", "move-green"], seen, np.array([0, 0, 0, 1, 1, 1]))
    assert [turn.skill for turn in found] == ["move-red", "move-blue"]
    np.testing.assert_array_equal(found[0].states, seen[:4])
    np.testing.assert_array_equal(found[1].states, seen[3:])


def test_rates_count_skills_never_come_to() -> None:
    outcomes = [Outcome(lifted=True, completed=True), Outcome(lifted=True, completed=False)]
    assert (recipes.lifted_rate(outcomes, asked=4), recipes.skills_completed(outcomes, asked=4)) == (0.5, 0.25)
