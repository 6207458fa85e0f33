import pytest

from freerein.data import read_choices
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
