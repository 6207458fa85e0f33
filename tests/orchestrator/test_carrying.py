"""Shaping by how near an object is to where a goal has it: ways over the top of another."""

import math

import pytest
import torch

from freerein.relations import SpatialRelation, caption
from freerein_orchestrator.rewards.carrying import goal_place, nearness, nearness_of, way_over


@pytest.mark.parametrize(
    ("start", "end", "length"),
    [
        ((3.0, 0.0), (3.0, 4.0), 4.0),  # straight: nothing is in between
        ((-5.0, 0.0), (-2.0, 0.0), 3.0),
        ((-1.0, 0.0), (1.0, 0.0), math.pi),  # half around
        ((-math.sqrt(2), 0.0), (math.sqrt(2), 0.0), 2 + math.pi / 2),  # two tangents and a quarter
        ((-1.0, -1e-3), (1.0, -1e-3), math.pi),  # over the top, though below is as near
        ((0.1, 0.0), (0.0, 1.0), math.pi / 2),  # a place within the disc is on its rim
    ],
)
def test_a_way_leads_over_the_top(start: tuple[float, float], end: tuple[float, float], length: float) -> None:
    found = way_over(torch.tensor([start]), torch.tensor(end))
    torch.testing.assert_close(found, torch.tensor([length]), atol=5e-3, rtol=0)


def test_what_is_lifted_from_the_wrong_side_is_nearer_than_what_is_pushed_against_the_other() -> None:
    place = goal_place(caption("a red block", SpatialRelation.LEFT_OF, "a green block"))
    assert place is not None
    offsets = torch.tensor([[3.0, 0.0], [1.0, 0.0], [0.7, 0.8], [0.0, 1.2], [-1.0, 0.8], [-1.4, 0.0]])
    near = nearness(offsets, place)
    assert (near.diff() > 0).all()
    assert 0 < near[0] < near[-1] <= 6


def test_what_is_to_be_close_is_nearer_the_less_it_is_away_until_it_is_close() -> None:
    near = nearness_of("a blue puck close to a red puck")
    assert near is not None
    found = near(torch.tensor([[0.0, -9.0], [3.0, 0.0], [0.0, 2.0], [1.0, 1.0]]))
    torch.testing.assert_close(found, torch.tensor([0.0, 6 - 1.1, 6 - 0.1, 6.0]))
    assert nearness_of("a blue puck apart from a red puck") is None


def test_a_relation_that_nothing_is_put_into_has_no_place() -> None:
    assert goal_place(caption("a red block", SpatialRelation.APART_FROM, "a green block")) is None
    assert goal_place("") is None
