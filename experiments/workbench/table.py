"""The table of an experiment: `table.md`, `table.json` with its claims, and `table.png`."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path

from experiments.workbench.claims import Claim
from experiments.workbench.results import TABLE_FILE
from freerein.atomic_files import write_atomic

_INCH_PER_CLAIM, _FRAME_INCHES, _WIDTH_INCHES, _DPI = 0.32, 1.1, 8.0, 110


@dataclass(frozen=True)
class Table:
    """A table as it is shown.

    Attributes:
        title: Heading.
        text: Sentences on what was measured, and how, in Markdown.
        header: Titles of the columns.
        rows: Cells of each row.
        claims: The claims of the table.
        plotted: Those of them that the plot shows.
        unit: What the claims' values are, for the plot's axis.
    """

    title: str
    text: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    claims: tuple[Claim, ...]
    plotted: tuple[Claim, ...]
    unit: str


def save(table: Table, folder: Path) -> None:
    """Writes the files of the table; equal tables give equal bytes of the first two."""
    document = {"claims": [asdict(claim) for claim in table.claims]}
    write_atomic(folder / "table.md", markdown(table).encode())
    write_atomic(folder / TABLE_FILE, json.dumps(document, indent=2, allow_nan=False).encode() + b"\n")
    write_atomic(folder / "table.png", _plot(table.plotted, title=table.title, unit=table.unit))


def markdown(table: Table) -> str:
    """Returns the table as Markdown."""
    lines = [table.header, tuple("---" for _ in table.header), *table.rows]
    cells = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"# {table.title}\n\n{table.text}\n\n{cells}\n\n![Values, 95 % intervals, ceilings](table.png)\n"


def _plot(claims: Sequence[Claim], *, title: str, unit: str) -> bytes:
    """Returns a PNG: a row for each claim, with its interval, its ceiling and the dissertation's figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure((_WIDTH_INCHES, _FRAME_INCHES + _INCH_PER_CLAIM * len(claims)), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(title=title, xlabel=unit)
    rows = range(len(claims))
    for row, claim in zip(rows, claims, strict=True):
        if claim.low is not None and claim.high is not None:
            axes.plot([claim.low, claim.high], [row, row], color="tab:blue", linewidth=3, alpha=0.4)
    axes.plot([claim.value for claim in claims], list(rows), "o", color="tab:blue", label="here, 95 % interval")
    for label, marker, values in (
        ("ceiling", "|", [claim.ceiling for claim in claims]),
        ("dissertation", "x", [claim.dissertation for claim in claims]),
    ):
        known = [(value, row) for value, row in zip(values, rows, strict=True) if value is not None]
        if known:
            x, y = zip(*known, strict=True)
            axes.plot(x, y, marker, color="black", markersize=9, label=label)
    axes.set_yticks(rows, [claim.claim for claim in claims])
    axes.invert_yaxis()
    axes.legend(loc="best", fontsize="small")
    image = BytesIO()
    figure.savefig(image, format="png", metadata={"Software": None})
    return image.getvalue()
