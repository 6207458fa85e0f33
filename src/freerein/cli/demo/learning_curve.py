"""The picture of a policy that learns: its return as it learns, and beside what it earns before and after."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from freerein.cli.demo.evaluating import Earned
from freerein.cli.demo.ink import FAINT, GOOD, INK, PAPER

_QUIET = "#cfd6e4"
_REACH = 7  # iterations to either side: those in which every environment has ended some episodes


def draw(
    path: Path, curve: Sequence[tuple[int, float]], bars: Mapping[str, Earned], *, title: str, subtitle: str
) -> None:
    """Writes the picture as PNG.

    Args:
        path: Where to.
        curve: Iterations, and the learned return of each.
        bars: By name, what was earned by the oracle's reward; chance first.
        title: In bold.
        subtitle: Below it.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 5.2), dpi=140, facecolor=PAPER)
    left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": [1.9, 1], "wspace": 0.12})
    figure.subplots_adjust(left=0.055, right=0.985, top=0.78, bottom=0.12)
    _curve(left, curve)
    _bars(right, bars)
    figure.text(0.055, 0.925, title, fontsize=16, fontweight="bold", color=INK)
    figure.text(0.055, 0.87, subtitle, fontsize=11, color=FAINT)
    figure.savefig(path)


def _curve(axes: Any, curve: Sequence[tuple[int, float]]) -> None:
    """Draws the returns, faint, and their mean over the iterations about each."""
    iterations, returns = np.array(curve).T
    about = np.abs(iterations[:, None] - iterations) <= _REACH
    axes.fill_between(iterations, returns, color=_QUIET, alpha=0.6, linewidth=0)
    axes.plot(iterations, about @ returns / about.sum(axis=1), color=INK, linewidth=2.2)
    axes.set(xlim=(iterations[0], iterations[-1]), ylim=(0, None))
    axes.set_xlabel("iteration", fontsize=11, color=FAINT)
    axes.set_title("return by the learned reward", fontsize=12, color=INK, loc="left")
    _quiet(axes)


def _bars(axes: Any, bars: Mapping[str, Earned]) -> None:
    """Draws a bar with its interval for each: green where that lies above the interval of the first one."""
    earned = list(bars.values())
    means = [each.mean for each in earned]
    reach = [[each.mean - each.low for each in earned], [each.high - each.mean for each in earned]]
    colours = [GOOD if each.low > earned[0].high else _QUIET for each in earned]
    axes.bar(list(bars), means, yerr=reach, color=colours, width=0.62, ecolor=INK, capsize=5)
    axes.set_title("control steps at the goal, of 100, in truth", fontsize=12, color=INK, loc="left")
    axes.set(ylim=(0, None))
    _quiet(axes)
    axes.tick_params(axis="x", labelsize=11, labelcolor=INK)


def _quiet(axes: Any) -> None:
    axes.tick_params(colors=FAINT, labelsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(FAINT)
