"""Actions that people bring as a CSV file, a line for each image."""

import csv
import io
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput

_MOST = float(np.finfo(np.float32).max)


def read_actions(table: bytes, *, file: str) -> tuple[tuple[str, ...], npt.NDArray[np.float64]]:
    """Returns the actions in a CSV file: names of their numbers, empty without a header, and float64 (T, A).

    Raises InvalidInput, with the name `file`, where lines differ in length or hold other than finite numbers.
    """
    try:
        lines = [line for line in csv.reader(io.StringIO(table.decode("utf-8-sig"), newline=""), strict=True) if line]
    except (UnicodeDecodeError, csv.Error):
        lines = []
    names = () if not lines or _floats(lines[0]) else tuple(name.strip() for name in lines[0])
    rows = [_floats(line) for line in lines[bool(names) :]]
    if not rows or len({len(row) for row in rows} | ({len(names)} if names else set())) != 1 or not rows[0]:
        raise InvalidInput(
            f"`{file}` must be CSV with the action of an image in each line, as many finite numbers in each; "
            "it is not.",
            field="actions",
            hint="For example the lines 0.5,-0.1 and 0.5,0; a first line such as x,y may name the numbers.",
        )
    return names, np.array(rows)


def _floats(cells: Sequence[str]) -> list[float]:
    """Returns the numbers of a line; none where one is no finite float32."""
    try:
        numbers = [float(text) for text in cells]
    except ValueError:
        return []
    return numbers if all(abs(number) <= _MOST for number in numbers) else []
