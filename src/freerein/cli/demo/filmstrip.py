"""The picture of a policy that follows goal images: each goal above what the robot saw when it was done with it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.cli.demo.ink import BAD, FAINT, GOOD, INK, PAPER


@dataclass(frozen=True, eq=False)
class Pursued:
    """One goal and how its pursuit ended.

    Attributes:
        goal: uint8 (H, W, 3).
        seen: uint8 (H, W, 3), what the robot saw at its end.
        step: Control steps since the episode began.
        confidence: That the goal was reached, in [0, 1].
        reached: Whether it truly was.
    """

    goal: npt.NDArray[np.uint8]
    seen: npt.NDArray[np.uint8]
    step: int
    confidence: float
    reached: bool


def draw(path: Path, pursued: Sequence[Pursued], *, title: str, subtitle: str) -> None:
    """Writes the picture as PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 4.7), dpi=140, facecolor=PAPER)
    rows = figure.subplots(2, len(pursued), squeeze=False)
    figure.subplots_adjust(left=0.07, right=0.99, top=0.80, bottom=0.07, wspace=0.06, hspace=0.06)
    for column, one in enumerate(pursued):
        _show(rows[0][column], one.goal, FAINT)
        _show(rows[1][column], one.seen, GOOD if one.reached else BAD)
        said = f"step {one.step} · {one.confidence:.2f}"
        rows[1][column].set_xlabel(said, fontsize=11, color=INK, labelpad=5)
    for row, name in zip(rows, ("goal", "seen"), strict=True):
        row[0].set_ylabel(name, rotation=0, ha="right", va="center", fontsize=12, color=INK, labelpad=8)
    figure.text(0.07, 0.92, title, fontsize=16, fontweight="bold", color=INK)
    figure.text(0.07, 0.855, subtitle, fontsize=11, color=FAINT)
    figure.savefig(path)


def _show(axes: Any, image: npt.NDArray[np.uint8], edge: str) -> None:
    axes.imshow(image, interpolation="nearest")
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(color=edge, linewidth=2.5)
