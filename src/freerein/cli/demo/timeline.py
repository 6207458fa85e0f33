"""The picture of a labelled trajectory: its frames, the true skills, the predicted ones, and the confidence."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.cli.demo.ink import BAD, FAINT, INK, PAPER

_FILM = 9

_PALETTE = {
    "red": "#d63a3a",
    "green": "#2f9e58",
    "yellow": "#e8b50c",
    "blue": "#2f6fde",
    "purple": "#8a4fd0",
    "magenta": "#c2399f",
    "orange": "#e8772e",
    "cyan": "#17a3b0",
}
_OTHERS = ("#4c6a92", "#a06a3f", "#5a8f7b", "#7a5c86", "#b0574f")


@dataclass(frozen=True, eq=False)
class Labelled:
    """A held-out trajectory and what was said of it.

    Attributes:
        frames: uint8 (T, H, W, C).
        truth: int64 (T,), indices into `skills`.
        labels: int64 (T,), likewise.
        confidence: float32 (T,), in [0, 1].
        skills: The skills' names.
    """

    frames: npt.NDArray[np.uint8]
    truth: npt.NDArray[np.int64]
    labels: npt.NDArray[np.int64]
    confidence: npt.NDArray[np.float32]
    skills: tuple[str, ...]

    @property
    def accuracy(self) -> float:
        """The share of timesteps labelled right."""
        return float(np.mean(self.labels == self.truth))


def draw(path: Path, labelled: Labelled, *, title: str) -> None:
    """Writes the picture as PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 5.4), dpi=140, facecolor=PAPER)
    rows = figure.subplots(4, 1, gridspec_kw={"height_ratios": [2.3, 0.8, 0.8, 1.2], "hspace": 0.28})
    figure.subplots_adjust(left=0.085, right=0.985, top=0.86, bottom=0.16)
    _film(rows[0], labelled.frames)
    _band(rows[1], "truth", labelled.truth, labelled.skills)
    _band(rows[2], "predicted", labelled.labels, labelled.skills)
    _confidence(rows[3], labelled)
    figure.text(0.085, 0.93, title, fontsize=16, fontweight="bold", color=INK)
    right = f"{labelled.accuracy:.1%} of {len(labelled.truth)} timesteps right"
    figure.text(0.085, 0.885, f"{right}; learned from the set of skills per trajectory", fontsize=11, color=FAINT)
    _legend(figure, labelled)
    figure.savefig(path)


def colour(skill: str, index: int) -> str:
    """Returns the colour that a skill is drawn in: that of its object, where its name tells."""
    words = skill.replace("_", "-").split("-")
    return next((_PALETTE[word] for word in words if word in _PALETTE), _OTHERS[index % len(_OTHERS)])


def _film(axes: Any, frames: npt.NDArray[np.uint8]) -> None:
    picks = ((np.arange(_FILM) + 0.5) * len(frames) / _FILM).astype(int)
    height, width = frames.shape[1:3]
    gap = max(1, width // 24)
    strip = np.full((height, _FILM * (width + gap) - gap, 3), 255, np.uint8)
    for place, pick in enumerate(picks):
        strip[:, place * (width + gap) : place * (width + gap) + width] = frames[pick]
    axes.imshow(strip, interpolation="nearest")
    axes.axis("off")


def _band(axes: Any, name: str, labels: npt.NDArray[np.int64], skills: tuple[str, ...]) -> None:
    starts = np.flatnonzero(np.diff(labels, prepend=-1))
    ends = np.append(starts[1:], len(labels))
    for start, end in zip(starts, ends, strict=True):
        skill = int(labels[start])
        axes.barh(
            0, end - start, left=start, height=1, color=colour(skills[skill], skill), edgecolor=PAPER, linewidth=1.5
        )
    axes.set(xlim=(0, len(labels)), ylim=(-0.5, 0.5), yticks=[], xticks=[])
    axes.set_ylabel(name, rotation=0, ha="right", va="center", fontsize=12, color=INK)
    axes.spines[:].set_visible(False)


def _confidence(axes: Any, labelled: Labelled) -> None:
    steps = np.arange(len(labelled.confidence)) + 0.5
    axes.fill_between(steps, labelled.confidence, color="#cfd6e4", linewidth=0)
    axes.plot(steps, labelled.confidence, color=INK, linewidth=1.4)
    wrong = np.flatnonzero(labelled.labels != labelled.truth)
    axes.plot(wrong + 0.5, np.full(len(wrong), 0.04), "|", color=BAD, markersize=7)
    axes.set(xlim=(0, len(steps)), ylim=(0, 1.05), yticks=[0, 1])
    axes.set_ylabel("confidence", rotation=0, ha="right", va="center", fontsize=12, color=INK)
    axes.set_xlabel("timestep", fontsize=11, color=FAINT)
    axes.tick_params(colors=FAINT, labelsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(FAINT)


def _legend(figure: Any, labelled: Labelled) -> None:
    from matplotlib.patches import Patch

    used = sorted(set(labelled.truth.tolist()) | set(labelled.labels.tolist()))
    handles = [Patch(color=colour(labelled.skills[i], i), label=labelled.skills[i]) for i in used]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, fontsize=11, labelcolor=INK)
