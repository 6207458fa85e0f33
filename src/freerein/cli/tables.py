"""Tables on the terminal: a line for each thing, of which no name is cut."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate
from textwrap import wrap
from typing import Literal

import typer
from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from freerein.cli.output import print_json

LastColumn = Literal["whole", "cut", "wrapped", "left out"]
"""What becomes of a last column that is too wide for the terminal: it is cut or wrapped between words, or left out with
others before it, and named below."""

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
    if last == "cut" and shown[-1:] != [len(columns) - 1]:
        last = "whole"  # what is last now may be a name
    whole = [[row[place] for place in shown] for row in [columns, *table]]
    count = _fitting(whole, width) if last == "left out" and width is not None else len(shown)
    console = Console(soft_wrap=True, highlight=False)
    for number, line in enumerate(table_lines([row[:count] for row in whole], width=width, last=last)):
        console.print(Text(line, "bold" if number == 0 else ""))
    if left_out := whole[0][count:]:
        typer.echo(f"Too wide for the terminal: {', '.join(left_out)}. --json has all.", err=True)


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


def _fitting(table: Sequence[Sequence[str]], width: int) -> int:
    """Returns how many of the first columns fit a terminal, at least two."""
    widths = [max(map(cell_len, cells)) + len(_GAP) for cells in zip(*table, strict=True)]
    return max(2, sum(total - len(_GAP) <= width for total in accumulate(widths)))


def _fitted(text: str, width: int | None, last: LastColumn) -> list[str]:
    """Returns the lines of a cell of the last column."""
    if not text or width is None or last in ("whole", "left out") or cell_len(text) <= width:
        return [text]
    room = max(width, _LEAST_WIDTH) if last == "wrapped" else max(width - len(_CUT), 1)
    parts = wrap(text, room, break_long_words=False, break_on_hyphens=False)
    if last == "wrapped":
        return parts
    return [parts[0] + _CUT if cell_len(parts[0]) <= width - len(_CUT) else ""]
