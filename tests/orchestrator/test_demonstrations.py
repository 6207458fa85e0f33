"""Why a robot did not reach all landmarks of a demonstration."""

from typing import Any

import numpy as np
import pytest

from freerein_orchestrator.kinds.evaluate.demonstration import failure, without_effect

AT_FIRST = ("0100000", "0000000")
"""It is at the first of two landmarks after one action, and never at the second."""


def why(*at: str, pursued: list[int], stuck: str = "000000", max_steps: int = 4, touched: bool = False) -> str:
    """Returns why a robot failed, given where it was, landmarks that were over, and actions without effect."""
    rows = np.array([[each == "1" for each in row] for row in at])
    is_stuck = np.array([each == "1" for each in stuck])
    return failure(rows, np.array(pursued), is_stuck, max_steps=max_steps, has_touched=touched)


def test_a_robot_that_reached_all_landmarks_has_not_failed_though_it_reached_one_late() -> None:
    assert why("0100000", "0000010", pursued=[0, 1, 2, 2, 2, 2], touched=True) == ""


@pytest.mark.parametrize(("limit", "expected"), [(3, "lost"), (4, "flag")])
def test_a_robot_fails_by_its_flag_where_it_goes_on_before_its_steps_are_used_up(limit: int, expected: str) -> None:
    assert why(*AT_FIRST, pursued=[0, 1, 1, 1, 2, 2], max_steps=limit) == expected
    assert why(*AT_FIRST, pursued=[0, 1, 1, 1, 2, 2], max_steps=limit, stuck="011100", touched=True) == (
        "blocked" if expected == "lost" else expected
    )


def test_a_first_landmark_is_left_by_the_flag_at_the_first_frame() -> None:
    assert why("0000000", "0000000", pursued=[1, 1, 1, 1, 1, 1]) == "flag"


def test_a_flag_is_right_where_the_robot_was_there_though_it_missed_the_landmark_before() -> None:
    assert why("0000010", "0010000", pursued=[0, 1, 2, 2, 2, 2]) == "lost"


def test_a_robot_is_blocked_where_half_of_its_actions_for_the_landmark_have_no_effect() -> None:
    assert why(*AT_FIRST, pursued=[0, 0, 1, 1, 1, 1], stuck="000011") == "blocked"
    assert why(*AT_FIRST, pursued=[0, 0, 1, 1, 1, 1], stuck="110001") == "lost"
    assert why(*AT_FIRST, pursued=[0, 0, 1, 1, 1, 1], touched=True) == "blocked"


def test_a_robot_that_never_came_to_pursue_the_landmark_is_lost() -> None:
    assert why(*AT_FIRST, pursued=[0, 0, 0, 0, 0, 0], stuck="111111") == "lost"


def test_an_action_has_no_effect_where_it_changes_no_number_and_is_not_holding() -> None:
    actions: Any = np.array([[0], [1], [1], [2]])
    states = np.array([[0.0, 5.0], [0, 5], [0, 5], [0, 6], [0, 6]])
    assert without_effect(actions, states, np.array([0])).tolist() == [False, True, False, True]
