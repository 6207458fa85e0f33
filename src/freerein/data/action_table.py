"""Actions that people bring as a CSV file, a line for each image."""

import csv
import io
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput

_MOST = float(np.finfo(np.float32).max)


def read_actions(table: bytes, *, file: str) -> tuple[tuple[str, ...], npt.NDArray[np.float64]]:
    """Returns the actions in a CSV file: names of their numbers, empty without a header, and float64 (T, A).

    Raises InvalidInput, with the name `file`, where lines differ in length or hold other than finite numbers.
    """
    names, rows = _read(table, file)
    return names, np.array([row.numbers for row in rows])


def read_choices(table: bytes, *, file: str, choices: int) -> npt.NDArray[np.int64]:
    """Returns the discrete actions in a CSV file, int64 (T, A).

    Raises InvalidInput as `read_actions`, and with line and column where a number is not among 0 to `choices` - 1.
    """
    _, rows = _read(table, file)
    for row in rows:
        for column, number in enumerate(row.numbers, start=1):
            if number not in range(choices):
                raise InvalidInput(
                    f"Line {row.line}, column {column}, of `{file}` must be a whole number in [0, {choices - 1}]; "
                    "it is not.",
                    field="actions",
                    hint="The model's actions are choices, counted from 0.",
                )
    return np.array([row.numbers for row in rows], np.int64)


class _Row(NamedTuple):
    """The numbers of a line, which is counted from 1."""

    line: int
    numbers: list[float]


def _read(table: bytes, file: str) -> tuple[tuple[str, ...], list[_Row]]:
    """Returns the names of a first line that has no numbers, and the numbers of the other lines, as many in each."""
    try:
        reader = csv.reader(io.StringIO(table.decode("utf-8-sig"), newline=""), strict=True)
        lines = [(reader.line_num, line) for line in reader if line]
    except (UnicodeDecodeError, csv.Error):
        lines = []
    names = () if not lines or any(map(_is_number, lines[0][1])) else tuple(name.strip() for name in lines[0][1])
    rows = [_Row(number, _floats(cells)) for number, cells in lines[bool(names) :]]
    lengths = {len(row.numbers) for row in rows} | ({len(names)} if names else set())
    if not rows or len(lengths) != 1 or not rows[0].numbers:
        raise InvalidInput(
            f"`{file}` must be CSV with the action of an image in each line, as many finite numbers in each; "
            "it is not.",
            field="actions",
            hint="For example the lines 0.5,-0.1 and 0.5,0; a first line such as x,y may name the numbers.",
        )
    return names, rows


def _is_number(cell: str) -> bool:
    """Returns whether a cell is a number, infinite ones and `nan` included."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _floats(cells: Sequence[str]) -> list[float]:
    """Returns the numbers of a line; none where one is no finite float32."""
    try:
        numbers = [float(text) for text in cells]
    except ValueError:
        return []
    return numbers if all(abs(number) <= _MOST for number in numbers) else []
