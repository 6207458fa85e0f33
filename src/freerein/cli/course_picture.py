"""The course of a fit or run as a terminal shows it."""

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from freerein.cli.terminal_plot import plot
from freerein.cli.course import Course
from freerein.cli.underway import Underway, steps_of

_CURVES, _CURVE_LINES, _BAR_WIDTH = 4, 2, 30
_NARROWEST, _WIDEST, _BESIDE = 10, 60, 50
_COLOURS = {"running": "cyan", "succeeded": "green", "failed": "red", "cancelled": "yellow"}


def draw(name: str, course: Course, metrics: Sequence[str] | None = None, *, width: int) -> RenderableType:
    """Returns how a fit or run stands, and below its curves.

    Args:
        name: What it is called.
        course: What was seen of it.
        metrics: Whose curves are drawn; those that tell most where it is None.
        width: Characters per line of the terminal.
    """
    if course.now is None:
        return Text(f"{name}  …", style="bold")
    standing = _standing(name, course.now, course.seconds_left)
    curves = Table.grid(padding=(0, 2, 1, 0))
    plot_width = min(_WIDEST, max(_NARROWEST, width - _BESIDE))
    for metric, values in course.curves(metrics, most=_CURVES).items():
        drawn = "\n".join(plot(values, width=plot_width, height=_CURVE_LINES))
        span = f"\n{min(values):.4g} to {max(values):.4g}"
        curves.add_row(metric, Text(drawn, "cyan"), Text.assemble((f"{values[-1]:.4g}", "bold"), (span, "dim")))
    return Group(standing, curves) if curves.row_count else standing


def _standing(name: str, now: Underway, seconds_left: float | None) -> RenderableType:
    bar = ProgressBar(total=now.steps or None, completed=now.step, width=_BAR_WIDTH)
    left = "" if seconds_left is None else f"{int(seconds_left) // 60}:{int(seconds_left) % 60:02} left"
    line = Table.grid(padding=(0, 2))
    state = Text(now.state, _COLOURS.get(now.state, ""))
    line.add_row(Text(name, "bold", no_wrap=True), state, bar, steps_of(now), Text(left))
    return line
