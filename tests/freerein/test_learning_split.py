import pytest

from freerein.errors import InvalidInput
from freerein.learning.split import train_validation_split


def test_a_seed_decides_what_is_held_out_and_every_release_draws_the_same() -> None:
    assert train_validation_split(range(10), fraction=0.3, seed=0) == ([0, 1, 3, 5, 7, 8, 9], [2, 4, 6])
    assert (
        train_validation_split([3, 5, 8, 13], fraction=0.25, seed=1)[1]
        != train_validation_split([3, 5, 8, 13], fraction=0.25, seed=0)[1]
    )


@pytest.mark.parametrize(("share", "held_out"), [(0.0, 1), (0.1, 1), (0.5, 2), (1.0, 2)])
def test_there_is_something_on_both_sides(share: float, held_out: int) -> None:
    sides = train_validation_split([4, 7, 9], fraction=share, seed=0)
    assert len(sides[1]) == held_out
    assert sorted(sides[0] + sides[1]) == [4, 7, 9]


def test_a_single_item_cannot_be_split() -> None:
    with pytest.raises(InvalidInput, match="at least 2 labelled trajectories"):
        train_validation_split([3], fraction=0.1, seed=0, unit="labelled trajectories")
