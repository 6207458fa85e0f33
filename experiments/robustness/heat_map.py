"""The picture of the benchmark: a cell for each model and condition, with its value in per cent."""

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.workbench.plots import new_figure, png

_FRAME_INCHES, _INCH_PER_ROW, _INCH_PER_COLUMN = 2.2, 0.27, 0.55
_GAP_POINTS = 5


def heat_map(
    values: Mapping[tuple[str, str], float],
    *,
    rows: Sequence[str],
    groups: Mapping[str, Sequence[str]],
    title: str,
) -> bytes:
    """Returns a PNG of values in [0, 100]; a missing one is left blank.

    Args:
        values: By row and column; the name of a column is its group's and its own, as in `segmentation, plain`.
        rows: Names of the rows.
        groups: Names of the columns of each group, with a gap between groups.
        title: Heading.
    """
    columns = [(group, name) for group, names in groups.items() for name in names]
    cells = np.array([[values.get((row, ", ".join(each)), np.nan) for each in columns] for row in rows])
    figure = new_figure(_FRAME_INCHES + _INCH_PER_COLUMN * len(columns), _FRAME_INCHES + _INCH_PER_ROW * len(rows))
    axes = figure.add_subplot()
    axes.set_title(title, pad=12)
    axes.imshow(cells, vmin=0, vmax=100, cmap="RdYlGn", aspect="auto")
    for row, column in np.argwhere(np.isfinite(cells)).tolist():
        axes.text(column, row, f"{cells[row, column]:.0f}", ha="center", va="center", fontsize="small")
    first = 0
    for group, names in groups.items():
        axes.axvline(first - 0.5, color="white", linewidth=_GAP_POINTS)
        middle = first + (len(names) - 1) / 2
        axes.text(middle, len(rows) - 0.3, group.replace(", ", ",\n"), ha="center", va="top", weight="bold")
        first += len(names)
    axes.set_xticks(range(len(columns)), [name for _, name in columns], fontsize="small", rotation=35, ha="left")
    axes.set_yticks(range(len(rows)), rows, fontsize="small")
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    return png(figure)
