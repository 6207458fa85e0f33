"""The style of pictures, `freerein.mplstyle`, and the colours of what they tell apart."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

INK, PAPER, FAINT, QUIET = "#1f2430", "#ffffff", "#8b93a3", "#cfd6e4"
GOOD, BAD = "#2f9e58", "#d63a3a"
_NAMED = {
    "red": "#d63a3a",
    "green": "#2f9e58",
    "yellow": "#e8b50c",
    "blue": "#2f6fde",
    "purple": "#8a4fd0",
    "magenta": "#c2399f",
    "orange": "#e8772e",
    "cyan": "#17a3b0",
}


@contextmanager
def figure_style() -> Iterator[None]:
    """Draws figures in the house's style; also a decorator."""
    from matplotlib import style

    with style.context(Path(__file__).with_name("freerein.mplstyle")):
        yield


def skill_colours(skills: Sequence[str]) -> list[str]:
    """Returns a colour for each skill: the one that its name mentions, else one of the style's, in turn."""
    from matplotlib import rcParams

    others: list[str] = rcParams["axes.prop_cycle"].by_key()["color"]
    colours = []
    for index, skill in enumerate(skills):
        named = (_NAMED[word] for word in skill.replace("_", "-").split("-") if word in _NAMED)
        colours.append(next(named, others[index % len(others)]))
    return colours


FILM_FRAMES = 9
"""Frames of a trajectory that a picture shows."""


def draw_film(axes: Any, frames: Sequence[npt.NDArray[np.uint8]], *, aspect: str = "equal") -> None:
    """Draws frames of a trajectory, uint8 (H, W, 1 or 3) each, side by side: some at equal distances, or all of few."""
    count = min(FILM_FRAMES, len(frames))
    picks = ((np.arange(count) + 0.5) * len(frames) / count).astype(int)
    height, width = frames[0].shape[:2]
    gap = max(1, width // 24)
    strip = np.full((height, count * (width + gap) - gap, 3), 255, np.uint8)
    for place, pick in enumerate(picks):
        strip[:, place * (width + gap) : place * (width + gap) + width] = frames[pick]
    axes.imshow(strip, aspect=aspect)
    axes.axis("off")


def draw_legend(figure: Any, names: Sequence[str], colours: Sequence[str]) -> None:
    """Draws a legend of skills below a figure's axes."""
    from matplotlib.patches import Patch

    handles = [Patch(color=colour, label=name) for name, colour in zip(names, colours, strict=True)]
    figure.legend(handles=handles, title="Skill", loc="lower center", ncols=min(8, len(handles)))
