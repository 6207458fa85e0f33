"""Actions as an action space has them."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from freerein.types.common import ActionSpec

CONTINUOUS, DISCRETE = ActionSpec(2, 0, ("x", "y")), ActionSpec(1, 4, ("a", "b", "c", "d"))
Array = npt.NDArray[np.generic]


@pytest.mark.parametrize(
    ("spec", "actions", "expected"),
    [
        (CONTINUOUS, np.array([[0, -1]]), np.array([[0, -1]], np.float32)),
        (CONTINUOUS, np.array([[1.0000001, -1.0009]], np.float32), np.array([[1, -1]], np.float32)),
        (CONTINUOUS, np.array([[0.3, 1.0011]], np.float32), np.array([[0.3, 1.0011]], np.float32)),
        (CONTINUOUS, np.array([[2, 0]]), np.array([[2, 0]], np.float32)),
        (CONTINUOUS, np.array([[np.nan, np.inf]], np.float32), np.array([[np.nan, np.inf]], np.float32)),
        (CONTINUOUS, np.array([[1.0, 2.0]]), np.array([[1.0, 2.0]])),
        (CONTINUOUS, np.empty((0, 2), np.int64), np.empty((0, 2), np.float32)),
        (DISCRETE, np.array([[3.0]], np.float32), np.array([[3]])),
        (DISCRETE, np.array([[0.5]], np.float32), np.array([[0.5]], np.float32)),
        (DISCRETE, np.array([[np.nan]], np.float32), np.array([[np.nan]], np.float32)),
        (DISCRETE, np.array([[4]]), np.array([[4]])),
        (DISCRETE, np.array([[3]], np.uint8), np.array([[3]], np.uint8)),
    ],
)
def test_actions_take_dtype_and_bounds_of_their_space_where_that_is_no_more_than_rounding(
    spec: ActionSpec, actions: Array, expected: Array
) -> None:
    taken = spec.normalised(actions)
    assert taken.dtype == expected.dtype
    np.testing.assert_array_equal(taken, expected)


@pytest.mark.parametrize(
    ("spec", "held"),
    [
        (CONTINUOUS, np.zeros(2, np.float32)),
        (replace(DISCRETE, hold=2), np.array([2])),
        (DISCRETE, np.array([-1])),
    ],
)
def test_a_robot_holds_by_zeros_or_by_the_choice_that_says_so(spec: ActionSpec, held: Array) -> None:
    np.testing.assert_array_equal(spec.hold_action(), held)
    assert spec.hold_action().dtype == spec.dtype
