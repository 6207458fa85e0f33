"""Tables on the terminal: a line for each thing, of which no name is cut."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from textwrap import wrap
from typing import Literal

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from freerein.cli.output import print_json

LastColumn = Literal["whole", "cut", "wrapped"]
"""What becomes of a last column that is too wide for the terminal; it is cut and wrapped between words."""

_GAP = "  "
_CUT = " …"
_LEAST_WIDTH = 24


def show_all(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    documents: Iterable[Mapping[str, object]],
    *,
    as_json: bool,
    last: LastColumn = "whole",
) -> None:
    """Prints a table, or the JSON document of each row."""
    if as_json:
        for document in documents:
            print_json(document)
    else:
        show_table(columns, rows, last=last)


def show_table(columns: Sequence[str], rows: Iterable[Sequence[str]], *, last: LastColumn = "whole") -> None:
    """Prints a table without its empty columns. All but the last are whole, and so is the last but on a terminal."""
    table = [list(row) for row in rows]
    shown = [place for place, name in enumerate(columns) if not table or any(row[place] for row in table)]
    width = Console().width if sys.stdout.isatty() else None
    if shown[-1:] != [len(columns) - 1]:
        last = "whole"
    lines = table_lines([[row[place] for place in shown] for row in [columns, *table]], width=width, last=last)
    console = Console(soft_wrap=True, highlight=False)
    for number, line in enumerate(lines):
        console.print(Text(line, "bold" if number == 0 else ""))


def table_lines(table: Sequence[Sequence[str]], *, width: int | None, last: LastColumn) -> list[str]:
    """Returns the lines of a table, its header among them.

    Args:
        table: Cells of each row, the header first.
        width: Width of the terminal; None for no bound.
        last: What becomes of a last column that is too wide.
    """
    widths = [max(map(cell_len, cells)) for cells in zip(*(row[:-1] for row in table), strict=True)]
    indent = sum(widths) + len(_GAP) * len(widths)
    lines = []
    for *cells, text in table:
        padded = "".join(cell + " " * (size - cell_len(cell)) + _GAP for cell, size in zip(cells, widths, strict=True))
        first, *more = _fitted(text, None if width is None else width - indent, last)
        lines += [f"{padded}{first}".rstrip(), *(" " * indent + each for each in more)]
    return lines


def _fitted(text: str, width: int | None, last: LastColumn) -> list[str]:
    """Returns the lines of a cell of the last column."""
    if not text or width is None or last == "whole" or cell_len(text) <= width:
        return [text]
    room = max(width, _LEAST_WIDTH) if last == "wrapped" else max(width - len(_CUT), 1)
    parts = wrap(text, room, break_long_words=False, break_on_hyphens=False)
    if last == "wrapped":
        return parts
    return [parts[0] + _CUT if cell_len(parts[0]) <= width - len(_CUT) else ""]
