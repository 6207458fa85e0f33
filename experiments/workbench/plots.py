"""Plots of claims, as PNG files."""

from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING

import PIL.Image

from experiments.workbench.claims import Claim

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = 128
_INCH_PER_CLAIM, _FRAME_INCHES, _WIDTH_INCHES, _DPI = 0.32, 1.1, 8.0, 110


def new_figure(width: float, height: float) -> "Figure":
    """Returns an empty figure of a size in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure((width, height), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def png(figure: "Figure") -> bytes:
    """Returns a figure as a PNG of few colours, a third as large: results are committed."""
    drawn, image = BytesIO(), BytesIO()
    figure.savefig(drawn, format="png")
    colours = PIL.Image.open(drawn).convert("RGB").quantize(_COLOURS, dither=PIL.Image.Dither.NONE)
    colours.save(image, "PNG", optimize=True)
    return image.getvalue()


def interval_plot(claims: Sequence[Claim], *, title: str, unit: str) -> bytes:
    """Returns a PNG: a row for each claim, with its interval, its ceiling and the dissertation's figure."""
    figure = new_figure(_WIDTH_INCHES, _FRAME_INCHES + _INCH_PER_CLAIM * len(claims))
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
    return png(figure)
