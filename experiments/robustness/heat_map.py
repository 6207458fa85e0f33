"""The picture of the benchmark: a cell for each model and condition, with its value in per cent."""

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.workbench.plots import new_figure, png

_WIDTH_INCHES, _FRAME_INCHES, _INCH_PER_ROW = 10.0, 1.8, 0.3
_DARK = 12
"""Value below which a cell's text is white."""


def heat_map(
    values: Mapping[tuple[str, str], float], *, rows: Sequence[str], columns: Sequence[str], title: str
) -> bytes:
    """Returns a PNG of values in [0, 100] by row and column; a missing one is left blank.

    A row of an empty name is a gap.
    """
    cells = np.array([[values.get((row, column), np.nan) for column in columns] for row in rows])
    figure = new_figure(_WIDTH_INCHES, _FRAME_INCHES + _INCH_PER_ROW * len(rows))
    axes = figure.add_subplot(title=title)
    axes.imshow(cells, vmin=0, vmax=100, cmap="RdYlGn", aspect="auto")
    for place, value in np.ndenumerate(cells):
        if np.isfinite(value):
            colour = "white" if value < _DARK else "black"
            axes.text(place[1], place[0], f"{value:.0f}", ha="center", va="center", color=colour, fontsize="small")
    axes.set_xticks(range(len(columns)), columns, fontsize="small")
    axes.set_yticks(range(len(rows)), rows, fontsize="small")
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    return png(figure)
