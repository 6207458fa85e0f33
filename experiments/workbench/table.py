"""The table of an experiment: `table.md`, `table.json` with its claims, and `table.png`."""

import json
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from experiments.workbench.claims import Claim
from experiments.workbench.results import TABLE_FILE
from freerein.atomic_files import write_atomic

WORDS = Path(__file__).parents[1] / "words"
"""Folder of the words of tables and pages."""


@dataclass(frozen=True)
class Section:
    """Cells under a heading.

    Attributes:
        header: Titles of the columns.
        rows: Cells of each row.
        title: Heading; empty for none.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""


@dataclass(frozen=True)
class Picture:
    """A picture: what it shows, in words, and what returns it as a PNG."""

    alt: str
    draw: Callable[[], bytes]


@dataclass(frozen=True)
class Table:
    """A table as it is shown.

    Attributes:
        title: Heading.
        text: Sentences on what was measured, and how, in Markdown.
        sections: The cells.
        claims: The claims of the table.
        picture: Its picture.
    """

    title: str
    text: str
    sections: tuple[Section, ...]
    claims: tuple[Claim, ...]
    picture: Picture


def words(name: str) -> str:
    """Returns the words of a table; `{how_ours}` in them stands for the words of that name."""
    text = (WORDS / f"{name}.md").read_text().strip()
    return re.sub(r"\{(how_\w+|guesses\w+)\}", lambda found: words(found[1]), text)


def save(table: Table, folder: Path) -> None:
    """Writes the files of the table; equal tables give equal bytes of the first two."""
    write_atomic(folder / "table.md", markdown(table).encode())
    write_atomic(folder / TABLE_FILE, claims_json(table).encode())
    write_atomic(folder / "table.png", table.picture.draw())


def markdown(table: Table) -> str:
    """Returns the table as Markdown."""
    sections = "\n\n".join(map(_section, table.sections))
    return f"# {table.title}\n\n{table.text}\n\n{sections}\n\n![{table.picture.alt}](table.png)\n"


def claims_json(table: Table) -> str:
    """Returns the claims of the table as JSON."""
    return json.dumps({"claims": [asdict(claim) for claim in table.claims]}, indent=2, allow_nan=False) + "\n"


def _section(section: Section) -> str:
    lines = [section.header, tuple("---" for _ in section.header), *section.rows]
    cells = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"## {section.title}\n\n{cells}" if section.title else cells
