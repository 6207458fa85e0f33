"""Switching goes on where true states say so, or where a goal's steps are used up."""

import numpy as np
import numpy.typing as npt

from freerein.types.common import Goal, Image
from freerein_orchestrator.envs.switching import IsAt, Switching

PLACES = ((1.0, 2.0, 3.0), (5.0,))
"""Where the goals of two environments are, on a line."""


def image(place: float) -> Image:
    return Image("raw_gray8", 1, 1, bytes([int(place)]))


def is_at(states: npt.NDArray[np.float64], index: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    there = [places[n] for places, n in zip(PLACES, index.tolist(), strict=True)]
    return np.asarray(states[:, 0] == there)


def pursued(*positions: tuple[float, float], max_steps: int, is_at: IsAt | None = is_at) -> list[list[int]]:
    """Returns how many goals are over before each action, given both positions then."""
    goals = [[Goal((image(place),)) for place in places] for places in PLACES]
    switching = Switching(goals, is_at, max_steps=max_steps)
    over = []
    for each in positions:
        switching.tell(np.array(each)[:, None])
        over.append(switching.index.tolist())
        for places, index, goal in zip(PLACES, switching.index.tolist(), switching.goals, strict=True):
            assert [each.data[0] for each in goal.images] == [places[min(index, len(places) - 1)]] * 2
    return over


def test_the_next_goal_is_given_where_the_present_one_is_truly_reached() -> None:
    positions = [(0, 5), (1, 5), (1, 5), (2, 5), (2, 0)]
    assert pursued(*positions, max_steps=9) == [[0, 1], [1, 1], [1, 1], [2, 1], [2, 1]]


def test_a_goal_is_given_up_after_its_steps() -> None:
    positions = [(0, 0)] * 6
    assert pursued(*positions, max_steps=2) == [[0, 0], [0, 0], [1, 1], [1, 1], [2, 1], [2, 1]]


def test_a_goal_has_its_steps_though_the_robot_is_there_where_steps_alone_count() -> None:
    positions = [(1, 5)] * 4
    assert pursued(*positions, max_steps=1, is_at=None) == [[0, 0], [1, 1], [2, 1], [3, 1]]
