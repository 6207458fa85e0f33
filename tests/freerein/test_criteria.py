"""The criteria of table 4.1 at keypoints that one can check by hand: x is right, y down, in object widths."""

import numpy as np
import pytest

from freerein.criteria import CRITERIA, View, criteria
from freerein.relations import SpatialRelation, classify_relation

HOLDS: dict[str, list[tuple[tuple[float, float], ...]]] = {
    "left_of": [((0, 0), (0.1, 9))],
    "right_of": [((0.1, 9), (0, 0))],
    "on_top_of": [((0, 0), (0, 1)), ((0.9, 0), (0, 1.4)), ((0, 0), (0, 0.6))],
    "below": [((0, 1), (0, 0))],
    "in_between": [((1, 5), (0, 0), (2, 9)), ((1, 5), (2, 0), (0, 9))],
    "in_front_of": [((0.1, 9), (0, 0))],
    "behind": [((0, 0), (0.1, 9))],
    "close_to": [((0, 0), (1.1, 1.5))],
    "inside_of": [((0, 0), (0.3, 0.3))],
}
FAILS: dict[str, list[tuple[tuple[float, float], ...]]] = {
    "left_of": [((0, 0), (0, 0)), ((1, 0), (0, 0))],
    "right_of": [((0, 0), (0, 0)), ((0, 0), (1, 0))],
    "on_top_of": [((0, 0), (0, 0.4)), ((0, 0), (1.1, 1)), ((0, 0), (0, 1.6)), ((0, 1), (0, 0))],
    "below": [((0, 0), (0, 1))],
    "in_between": [((0, 0), (0, 0), (2, 0)), ((3, 0), (0, 0), (2, 0)), ((-1, 0), (2, 0), (0, 0))],
    "in_front_of": [((0, 0), (1, 0))],
    "behind": [((1, 0), (0, 0))],
    "close_to": [((0, 0), (1.4, 1.4))],
    "inside_of": [((0, 0), (0.4, 0.4))],
}


@pytest.mark.parametrize("name", CRITERIA)
def test_a_criterion_holds_where_its_formula_says_so(name: str) -> None:
    criterion = CRITERIA[name]
    assert criterion.holds(np.array(HOLDS[name])).all()
    assert not criterion.holds(np.array(FAILS[name])).any()
    assert {len(keypoints) for keypoints in (*HOLDS[name], *FAILS[name])} == {criterion.nouns}
    assert all(f"{{{slot}}}" in wording for wording in criterion.wordings for slot in range(criterion.nouns))


def test_criteria_that_exclude_each_other_are_of_one_view_and_never_hold_together() -> None:
    keypoints = np.random.default_rng(0).normal(size=(10_000, 2, 2))
    for criterion in CRITERIA.values():
        for other in (CRITERIA[name] for name in criterion.excludes):
            assert criterion.name in other.excludes
            assert (criterion.view, criterion.nouns) == (other.view, other.nouns)
            assert not (criterion.holds(keypoints) & other.holds(keypoints)).any()


def test_a_margin_is_the_distance_to_the_nearest_place_of_the_other_answer_along_an_axis() -> None:
    stacked = np.array([[0.0, 0.0], [0.2, 1.0]])
    assert CRITERIA["on_top_of"].margin(stacked) == pytest.approx(0.5)
    assert CRITERIA["left_of"].margin(stacked) == pytest.approx(0.2)
    assert CRITERIA["right_of"].margin(stacked) == pytest.approx(-0.2)
    assert CRITERIA["close_to"].margin(np.array([[0.0, 0.0], [3.0, 4.0]])) == pytest.approx(1.9 - 5.0)


def test_a_thing_is_inside_where_the_centres_are_less_than_half_the_container_apart() -> None:
    apart = np.array([[0.0, 0.0], [1.1, 0.0]])
    assert not CRITERIA["inside_of"].holds(apart)
    assert criteria(container_width=2.4)["inside_of"].holds(apart)
    assert not criteria(container_width=2.0)["inside_of"].holds(apart)
    assert [*criteria(container_width=2.4)] == [*CRITERIA]


def test_in_one_view_the_five_relations_are_made_of_criteria() -> None:
    first, second = np.random.default_rng(0).normal(scale=1.5, size=(2, 10_000, 2))
    relations = classify_relation(first, second, epsilon=1.0)
    holds = {name: CRITERIA[name].holds(np.stack([first, second], axis=1)) for name in CRITERIA if name != "in_between"}
    beside = holds["close_to"] & ~holds["on_top_of"] & ~holds["below"]
    assert np.array_equal(relations == SpatialRelation.ON_TOP_OF, holds["on_top_of"])
    assert np.array_equal(relations == SpatialRelation.BELOW, holds["below"])
    assert np.array_equal(relations == SpatialRelation.LEFT_OF, beside & holds["left_of"])
    assert np.array_equal(relations == SpatialRelation.RIGHT_OF, beside & holds["right_of"])
    assert np.array_equal(relations == SpatialRelation.APART_FROM, ~holds["close_to"])


def test_each_view_has_criteria() -> None:
    assert {each.view for each in CRITERIA.values()} == set(View)


def test_places_of_another_number_of_nouns_are_refused() -> None:
    with pytest.raises(ValueError, match="in_between needs"):
        CRITERIA["in_between"].holds(np.zeros((5, 2, 2)))
