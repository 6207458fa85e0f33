"""Pictures of training curves and of returns by policy, drawn with matplotlib."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from freerein.cli.demo.evaluations import Measured
from freerein.cli.demo.pictures import new_figure
from freerein.cli.figure_style import FAINT, INK, QUIET, figure_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Curve = Sequence[tuple[int, float]]
"""Steps and values."""

_SMOOTHING_REACH = 7  # iterations to either side: those in which every environment has ended some episodes


@figure_style()
def returns_figure(curve: Curve, bars: Mapping[str, Mapping[str, Measured]], *, title: str, subtitle: str) -> "Figure":
    """Returns a training's learned return by iteration, and beside it panels of returns by policy."""
    figure = new_figure(5.2, title, subtitle, left=0.05, top=0.78)
    widths = [4, *map(len, bars.values())]  # as many as bars, so that their names fit
    left, *panels = figure.subplots(1, 1 + len(bars), gridspec_kw={"width_ratios": widths, "wspace": 0.2})
    figure.subplots_adjust(right=0.985, bottom=0.12)
    _draw_returns(left, curve)
    top = 1.1 * max(each.high or each.value for group in bars.values() for each in group.values())
    for panel, (name, group) in zip(panels, bars.items(), strict=True):
        _draw_bars(panel, group, name=name, top=top)
    return figure


@figure_style()
def episodes_figure(returns: Mapping[str, Sequence[float]], *, title: str, subtitle: str) -> "Figure":
    """Returns the return of each episode, side by side for each policy, by its name."""
    figure = new_figure(4.0, title, subtitle, left=0.05, top=0.78)
    axes = figure.subplots()
    figure.subplots_adjust(right=0.985, bottom=0.15)
    width = 0.8 / len(returns)
    for place, (name, values) in enumerate(returns.items()):
        at = np.arange(len(values)) + place * width
        axes.bar(at, values, width=width, align="edge", color=(INK, QUIET)[place % 2], label=name)
    axes.set(xticks=[], xlim=(-0.2, len(values)), ylim=(0, 100))
    axes.set_xlabel("episodes", color=FAINT)
    axes.set_ylabel("timesteps of 100", color=FAINT)
    axes.legend(loc="upper right", ncols=len(returns), bbox_to_anchor=(1, 1.16))
    return figure


def _draw_returns(axes: Any, curve: Curve) -> None:
    """Draws the returns, faint, and their moving average."""
    iterations, returns = np.array(curve).T
    near = np.abs(iterations[:, None] - iterations) <= _SMOOTHING_REACH
    axes.fill_between(iterations, returns, color=QUIET, alpha=0.6, linewidth=0)
    axes.plot(iterations, near @ returns / near.sum(axis=1), color=INK, linewidth=2.2)
    axes.set(xlim=(iterations[0], iterations[-1]), ylim=(0, None))
    axes.set_xlabel("iterations", color=FAINT)
    axes.set_ylabel("sum of rewards of an episode", color=FAINT)
    axes.set_title("return by the learned reward", fontsize=12)


def _draw_bars(axes: Any, bars: Mapping[str, Measured], *, name: str, top: float) -> None:
    means = np.array([each.value for each in bars.values()])
    low, high = np.transpose([each.interval or (each.value, each.value) for each in bars.values()])
    axes.bar(list(bars), means, yerr=(means - low, high - means), color=QUIET, width=0.62, ecolor=INK, capsize=5)
    axes.set_title(name, fontsize=12)
    axes.set(ylim=(0, top))
    axes.set_ylabel("timesteps of 100", color=FAINT)
    axes.tick_params(axis="x", labelsize=9.5, labelcolor=INK)
