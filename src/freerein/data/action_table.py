"""Actions that people bring as a CSV file, a line for each image."""

import csv
import io
import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput, must_be, quoted

_MOST = float(np.finfo(np.float32).max)
_EXAMPLE = "For example the lines 0.5,-0.1 and 0.5,0; a first line such as x,y may name the numbers."
_INDEX_HINT = "Name it, or leave it out: pandas writes a table without its index by to_csv(FILE, index=False)."
_UNNAMED = re.compile(r"Unnamed: \d+(_level_\d+)?")
"""The name that pandas gives a column without one."""


def read_actions(table: bytes, *, file: str) -> tuple[tuple[str, ...], npt.NDArray[np.float64]]:
    """Returns the actions in a CSV file: names of their numbers, empty without a header, and float64 (T, A).

    Raises InvalidInput, with the name `file`, line and column, where lines differ in length or hold other than finite
    numbers, a name is missing, or the first line counts the columns.
    """
    names, rows = _read(table, file)
    return names, np.array([numbers for _, numbers in rows])


def read_choices(table: bytes, *, file: str, choices: int) -> npt.NDArray[np.int64]:
    """Returns the discrete actions in a CSV file, int64 (T, A).

    Raises InvalidInput as `read_actions`, and with line and column where a number is not among 0 to `choices` - 1.
    """
    _, rows = _read(table, file)
    for line, numbers in rows:
        for column, number in enumerate(numbers, start=1):
            if number not in range(choices):
                place, rule = f"Line {line}, column {column}, of `{file}`", f"a whole number in [0, {choices - 1}]"
                hint = "The model's actions are choices, counted from 0."
                raise must_be(place, rule, f"{number:g}", field="actions", hint=hint)
    return np.array([numbers for _, numbers in rows], np.int64)


def _read(table: bytes, file: str) -> tuple[tuple[str, ...], list[tuple[int, list[float]]]]:
    """Returns the names of a first line without numbers; of the others the place and the numbers, as many in each."""
    lines = _lines(table, file)
    number, first = lines[0] if lines else (1, [])
    names = () if any(map(_is_number, first)) else tuple(name.strip() for name in first)
    _check_names(number, first, names, file)
    rows = [(line, _floats(line, cells, file)) for line, cells in lines[bool(names) :]]
    if not rows:
        found = "a line of names alone" if names else "no lines"
        raise _error(f"`{file}` must have the action of an image in each line; it has {found}", _EXAMPLE)
    for line, numbers in rows:
        if len(numbers) != len(first):
            expected = f"have {len(first)} numbers, as many as line {number}; it has {len(numbers)}"
            raise _error(f"Line {line} of `{file}` must {expected}", _EXAMPLE)
    if not names:
        _check_no_count(lines, file)
    return names, rows


def _lines(table: bytes, file: str) -> list[tuple[int, list[str]]]:
    """Returns the number and the cells of each line that is not empty."""
    try:
        reader = csv.reader(io.StringIO(table.decode("utf-8-sig"), newline=""), strict=True)
        return [(reader.line_num, line) for line in reader if line]
    except (UnicodeDecodeError, csv.Error) as error:
        rule = "CSV in UTF-8 with the action of an image in each line"
        raise _error(f"`{file}` must be {rule}; reading it failed: {error}", _EXAMPLE) from None


def _check_names(line: int, cells: Sequence[str], names: Sequence[str], file: str) -> None:
    """Raises InvalidInput where a column has no name, or two have one: pandas writes its index so."""
    nameless = [cell for cell in cells if not cell.strip() or _UNNAMED.fullmatch(cell.strip())]
    if nameless:
        place = f"Line {line}, column {cells.index(nameless[0]) + 1}, of `{file}`"
        raise _error(f"{place} must have a name, or a number as all others; got {quoted(nameless[0])}", _INDEX_HINT)
    if len(set(names)) != len(names):
        raise _error(f"Line {line} of `{file}` must have different names; one is there twice", "Rename a column.")


def _check_no_count(lines: Sequence[tuple[int, list[str]]], file: str) -> None:
    """Raises InvalidInput where the first line counts the columns, as it does for a table without names of its own."""
    number, first = lines[0]
    counts = [cell.strip() for cell in first] == [str(place) for place in range(len(first))]
    others = [cell.strip() for _, cells in lines[1:] for cell in cells]
    if counts and len(first) > 1 and any(not cell.isdigit() for cell in others):
        raise _error(
            f"Line {number} of `{file}` must be an action, or names; it counts the columns",
            "Write the table without such a line: DataFrame.to_csv(FILE, index=False, header=False).",
        )


def _is_number(cell: str) -> bool:
    """Returns whether a cell is a number, infinite ones and `nan` included."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _floats(line: int, cells: Sequence[str], file: str) -> list[float]:
    """Returns the numbers of a line; raises InvalidInput where one is no finite float32."""
    for column, cell in enumerate(cells, start=1):
        is_plain = cell.isascii() and "_" not in cell and _is_number(cell)  # as other programs write numbers, too
        if not (is_plain and abs(float(cell)) <= _MOST):
            place = f"Line {line}, column {column}, of `{file}`"
            raise must_be(place, "a finite number", quoted(cell), field="actions", hint=_EXAMPLE)
    return list(map(float, cells))


def _error(sentence: str, hint: str) -> InvalidInput:
    return InvalidInput(f"{sentence}.", field="actions", hint=hint)
