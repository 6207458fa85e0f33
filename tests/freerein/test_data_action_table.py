"""Tables of actions as people have them: lines and columns are named where they cannot be actions."""

import numpy as np
import pytest

from freerein.data import read_actions, read_choices
from freerein.data.counter_columns import CounterColumns
from freerein.errors import InvalidInput


def test_whole_numbers_are_choices() -> None:
    assert read_choices(b"button\n2\n\n0.0\n", file="a.csv", choices=3).tolist() == [[2], [0]]


@pytest.mark.parametrize(
    ("table", "place"),
    [
        (b"0\n0.7\n", "Line 2, column 1, of `a.csv` must be a whole number in \\[0, 2\\]"),
        (b"x,y\n\n0,1\n2,1.9\n", "Line 4, column 2,"),
        (b"3\n", "Line 1, column 1,"),
        (b"-1\n", "Line 1, column 1,"),
    ],
)
def test_what_is_no_choice_is_refused_by_line_and_column(table: bytes, place: str) -> None:
    with pytest.raises(InvalidInput, match=place):
        read_choices(table, file="a.csv", choices=3)


@pytest.mark.parametrize(
    ("table", "names", "actions"),
    [
        (b"\xef\xbb\xbfdx, dy\r\n0.5,-1e-3\r\n", ("dx", "dy"), [[0.5, -0.001]]),
        (b"0,1\n1,0\n", (), [[0, 1], [1, 0]]),  # one of two, not a count of columns
        (b"0\n0.5\n", (), [[0], [0.5]]),
        (b'"0.5","1"\n', (), [[0.5, 1]]),
    ],
)
def test_actions_are_the_numbers_below_a_line_of_names_or_without(
    table: bytes, names: tuple[str, ...], actions: list[list[float]]
) -> None:
    found = read_actions(table, file="a.csv")
    assert (found[0], found[1].tolist()) == (names, actions)


@pytest.mark.parametrize(
    ("table", "place"),
    [
        (b",dx,dy\n0,0.1,0.2\n", "Line 1, column 1, of `a.csv` must have a name"),
        (b"dx,dy, \n0.1,0.2,\n", "Line 1, column 3, of `a.csv` must have a name"),
        (b"Unnamed: 0,dx\n0,0.1\n", "Line 1, column 1, of `a.csv` must have a name"),
        (b",0,1\n0,0.1,0.2\n", "Line 1, column 1, of `a.csv` must have a name, or a number"),
        (b"0,1\n0.1,0.2\n", "Line 1 of `a.csv` must be an action, or names; it counts the columns"),
        (b"0,1,2\n0,-1,0\n", "Line 1 of `a.csv` must be an action, or names; it counts the columns"),
        (b"dx,dx\n1,2\n", "Line 1 of `a.csv` must have different names"),
        (b"dx,dy\n1,2\n\n1,2,3\n", "Line 4 of `a.csv` must have 2 numbers, as many as line 1; it has 3"),
        (b"1,2\n1\n", "Line 2 of `a.csv` must have 2 numbers"),
        (b"1,2\n1,x\n", "Line 2, column 2, of `a.csv` must be a finite number"),
        (b"1,nan\n", "Line 1, column 2, of `a.csv` must be a finite number"),
        (b"dx\n1e39\n", "Line 2, column 1, of `a.csv` must be a finite number"),
        (b"dx\n1_0\n", "Line 2, column 1, of `a.csv` must be a finite number"),
        ("dx\n\u0661\n".encode(), "Line 2, column 1, of `a.csv` must be a finite number"),
        (b"0,5;0,1\n", "Line 1, column 2, of `a.csv` must be a finite number"),
        (b"0.5\t0.1\n0.5\t0.1\n", "Line 2, column 1, of `a.csv` must be a finite number"),
        (b"dx,dy\n", "must have the action of an image in each line; it has"),
        (b"", "must have the action of an image in each line; it has"),
        (b"\xff\xfed\0x\0", "`a.csv` must be CSV in UTF-8"),
        (b'"1,2\n', "`a.csv` must be CSV in UTF-8"),
    ],
)
def test_what_is_no_action_is_refused_by_line(table: bytes, place: str) -> None:
    with pytest.raises(InvalidInput, match=place):
        read_actions(table, file="a.csv")


def warned(*columns: list[list[float]]) -> list[str]:
    """Returns the warnings of trajectories of columns named a, b, ..."""
    counters = CounterColumns(("a", "b"))
    for trajectory in columns:
        counters.add(np.array(trajectory, np.float32).T)
    return list(counters.sentences())


def test_columns_that_count_or_only_grow_are_named() -> None:
    assert warned([[0, 1, 2], [0.1, -0.2, 0]]) == [
        "Actions must not hold counters or clocks; `a` of them counts up by one in every trajectory."
    ]
    clock = [1.7e9 + 0.1 * step for step in range(6)]
    assert ["`b` of them only grows" in each for each in warned([[1, 0, 1, 0, 1, 0], clock])] == [True]
    assert len(warned([[5, 6, 7], [0, 1, 2]], [[0, 1, 2], [0, 1, 2]])) == 2


@pytest.mark.parametrize(
    "trajectories",
    [
        [[[0, 1], [1, 0]]],  # two timesteps may rise by chance
        [[[0, 1, 2], [0, 0, 1]], [[2, 1, 0], [1, 0, 0]]],  # grows in one of them alone
        [[[0, 0, 0, 0, 0, 1], [1, 1, 1, 1, 1, 1]]],  # a gripper that closes once
    ],
)
def test_motions_are_no_counters(trajectories: list[list[list[float]]]) -> None:
    assert warned(*trajectories) == []
