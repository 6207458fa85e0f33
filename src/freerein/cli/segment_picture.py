"""Segments on a terminal: a table, and the trajectory as a bar with a letter and a colour for each skill."""

from collections.abc import Sequence
from string import ascii_uppercase

from rich.console import Console
from rich.table import Table
from rich.text import Text

from freerein.types.segmentation import SegmentResponse

_COLOURS = ("cyan", "magenta", "yellow", "green", "blue", "red", "bright_cyan", "bright_magenta")
_WIDEST = 100


def show(answer: SegmentResponse) -> None:
    """Prints the segments of a trajectory."""
    console = Console()
    table = Table("", "skill", "from", "to", "confidence", box=None, header_style="bold", pad_edge=False)
    for segment in answer.segments:
        skill = answer.skills.index(segment.skill)
        table.add_row(
            _mark(skill), Text(segment.skill), str(segment.start), str(segment.end), f"{segment.confidence:.2f}"
        )
    console.print(table)
    console.print(bar([int(label) for label in answer.labels], width=min(console.width, _WIDEST)))
    console.print(f"{len(answer.labels)} timesteps, model {answer.model.name} {answer.model.version}", style="dim")


def bar(labels: Sequence[int], *, width: int) -> Text:
    """Returns a trajectory as one line of `width` letters at most: A for skill 0, in a colour of its own."""
    cells = min(width, len(labels))
    return Text.assemble(*(_mark(labels[cell * len(labels) // cells]) for cell in range(cells)))


def _mark(skill: int) -> Text:
    return Text(ascii_uppercase[skill % len(ascii_uppercase)], style=f"black on {_COLOURS[skill % len(_COLOURS)]}")
