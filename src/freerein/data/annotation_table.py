"""Lines of tables that people bring: comma-separated, or by tabs or spaces; errors name line and column."""

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from freerein.errors import InvalidInput, must_be, quoted


@dataclass(frozen=True)
class Line:
    """A line of a table: its number, from 1, and its cells by column."""

    number: int
    cells: Mapping[str, str]

    def integer(self, column: str, *, least: int, most: int) -> int:
        """Returns a cell that must be a whole number in [least, most]."""
        text = self.cells[column].strip()
        if not (text.isascii() and text.isdigit() and len(text) < 19 and least <= int(text) <= most):
            raise self.error(column, f"be a whole number in [{least}, {most}]; got {quoted(text)}", "Count from 0.")
        return int(text)

    def error(self, column: str, expected: str, hint: str) -> InvalidInput:
        """Returns the error of a cell."""
        return InvalidInput(f"Line {self.number}, column `{column}`, must {expected}.", field=column, hint=hint)


def lines(table: bytes, columns: tuple[str, ...], *, hint: str) -> Iterator[Line]:
    """Yields the lines below a header of exactly these columns, separated by commas; blank ones are left out.

    `hint` says how to mend a line that has another number of columns.
    """
    numbered = rows(table, ",")
    _, header = next(numbered, (1, []))
    if [name.strip() for name in header] != list(columns):
        hint = "Columns are separated by commas, in this order."
        raise must_be("Line 1", f"`{','.join(columns)}`", quoted(",".join(header)), field="header", hint=hint)
    for number, cells in numbered:
        yield line(number, cells, columns, hint=hint)


def line(number: int, cells: Sequence[str], columns: Sequence[str], *, hint: str) -> Line:
    """Returns a line; raises InvalidInput where it has not as many cells as there are columns."""
    if len(cells) != len(columns):
        raise InvalidInput(
            f"Line {number} must have {len(columns)} columns; it has {len(cells)}.",
            field=columns[min(len(cells), len(columns) - 1)],
            hint=hint,
        )
    return Line(number, dict(zip(columns, cells, strict=True)))


def rows(table: bytes, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Yields the number and the cells of each line that has any text.

    Args:
        table: In UTF-8.
        delimiter: What separates cells; a space for any number of them.

    Raises:
        InvalidInput: It is no such table.
    """
    try:
        text = table.decode("utf-8-sig")
        if delimiter == " ":
            text = re.sub(r"[^\S\n]+", " ", "\n".join(each.strip() for each in text.splitlines()))
        reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=delimiter)
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield reader.line_num, cells
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidInput(
            f"The file must be CSV in UTF-8; reading it failed: {error}.", hint="Save it as CSV, separated by commas."
        ) from None
