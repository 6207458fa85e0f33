"""The picture of rewards: what was seen, where each noun phrase was found, and which text fits best."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.cli.demo.ink import BAD, FAINT, GOOD, INK, PAPER

_GREATEST_OVERLAY = 0.75


@dataclass(frozen=True, eq=False)
class Judged:
    """One image and what the reward service said of it.

    Attributes:
        image: uint8 (H, W, 3).
        phrases: Noun phrases.
        heatmaps: float32 (H, W) in [0, 1] for each phrase.
        pixels: Where each phrase was found: x, y.
        texts: What it could be called.
        similarities: The cosine of the image and each text.
        truth: Index of the text that is true.
    """

    image: npt.NDArray[np.uint8]
    phrases: Sequence[str]
    heatmaps: Sequence[npt.NDArray[np.float32]]
    pixels: Sequence[tuple[float, float]]
    texts: Sequence[str]
    similarities: npt.NDArray[np.float32]
    truth: int


def draw(path: Path, judged: Sequence[Judged], *, title: str, subtitle: str) -> None:
    """Writes the picture as PNG: a row for each image."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 2.5 * len(judged) + 1.1), dpi=140, facecolor=PAPER)
    columns = 1 + len(judged[0].phrases) + 1
    ratios = [1.0] * (columns - 1) + [2.2]
    rows = figure.subplots(len(judged), columns, squeeze=False, gridspec_kw={"width_ratios": ratios, "wspace": 0.08})
    height = 2.5 * len(judged) + 1.1
    figure.subplots_adjust(left=0.02, right=0.98, top=1 - 0.95 / height, bottom=0.25 / height, hspace=0.16)
    for axes, one in zip(rows, judged, strict=True):
        _show(axes[0], one.image, "")
        for column, (phrase, heatmap, pixel) in enumerate(zip(one.phrases, one.heatmaps, one.pixels, strict=True), 1):
            _show(axes[column], _overlaid(one.image, heatmap), phrase)
            axes[column].plot(*pixel, "+", color=PAPER, markersize=14, markeredgewidth=2.2)
        _rank(axes[-1], one)
    figure.text(0.02, 1 - 0.38 / height, title, fontsize=16, fontweight="bold", color=INK)
    figure.text(0.02, 1 - 0.66 / height, subtitle, fontsize=11, color=FAINT)
    figure.savefig(path)


def _show(axes: Any, image: npt.NDArray[np.uint8], name: str) -> None:
    axes.imshow(image, interpolation="nearest")
    axes.set_title(name, fontsize=10.5, color=INK, pad=4)
    axes.axis("off")


def _overlaid(image: npt.NDArray[np.uint8], heatmap: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Returns the image under its heatmap."""
    from matplotlib import colormaps

    warm = colormaps["inferno"](heatmap)[..., :3] * 255
    share = _GREATEST_OVERLAY * heatmap[..., None]
    return np.asarray(image * (1 - share) * 0.6 + warm * (0.4 * (1 - share) + share), np.uint8)


def _rank(axes: Any, one: Judged) -> None:
    """Draws the similarity of each text, the winner in colour: green where it is true."""
    winner, places = int(np.argmax(one.similarities)), np.arange(len(one.texts))
    colours = ["#cfd6e4"] * len(one.texts)
    colours[winner] = GOOD if winner == one.truth else BAD
    axes.barh(places, one.similarities, color=colours, height=0.72)
    axes.axvline(0, color=FAINT, linewidth=0.8)
    left = axes.get_xlim()[0]
    for place, text in enumerate(one.texts):
        weight = "bold" if place == winner else "normal"
        axes.text(left, place, f" {text}", va="center", fontsize=10, color=INK, fontweight=weight)
    axes.set(yticks=[], xticks=[])
    axes.invert_yaxis()
    axes.spines[:].set_visible(False)
