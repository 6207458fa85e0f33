"""A labelled trajectory as a picture, drawn with matplotlib."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.cli.figure_style import FAINT, INK, draw_film, draw_legend, figure_style, skill_colours
from freerein.cli.segments.timeline import Timeline
from freerein.types.segmentation import NO_SKILL

_NONE = "#eef0f4"


@figure_style()
def draw(path: Path, timeline: Timeline, film: Sequence[npt.NDArray[np.uint8]]) -> None:
    """Writes a PNG: some frames, the skill of each timestep, its confidence, and how familiar it is.

    Args:
        path: The file.
        timeline: The labelled trajectory.
        film: Frames from its start to its end at equal distances, uint8 (H, W, 1 or 3); may be empty.
    """
    from matplotlib.figure import Figure

    answer = timeline.answer
    figure = Figure(figsize=(14, 5.0 if film else 3.4))
    heights = [2.2, 0.7, 1.1] if film else [0.7, 1.1]
    rows: Any = figure.subplots(len(heights), 1, gridspec_kw={"height_ratios": heights, "hspace": 0.25})
    figure.subplots_adjust(left=0.085, right=0.985, bottom=0.27 if film else 0.35, top=0.92)
    figure.suptitle("Skill timeline", x=0.085, ha="left", fontweight="bold")
    if film:
        draw_film(rows[0], film, aspect="auto")
    end_s = float(timeline.time_s[-1])
    colours = skill_colours(answer.skills)
    _draw_skills(rows[-2], timeline, colours)
    middle = (timeline.time_s[:-1] + timeline.time_s[1:]) / 2
    rows[-1].plot(middle, answer.confidence, color=INK, linewidth=1.4, label="confidence")
    rows[-1].plot(middle, answer.in_distribution, color=FAINT, linewidth=1.0, label="in-distribution score")
    rows[-1].set(xlim=(float(timeline.time_s[0]), end_s), ylim=(0, 1.05), yticks=[0, 1], xlabel="time (s)")
    rows[-1].legend(loc="lower right", fontsize=8)
    shown = dict(zip([*answer.skills, "none"], [*colours, _NONE], strict=True))
    names = [*answer.skills, "none"]  # by label: NO_SKILL is -1
    used = [names[label] for label in sorted(set(answer.labels.tolist()), key=lambda label: label == NO_SKILL)]
    draw_legend(figure, used, [shown[name] for name in used])
    figure.savefig(path)


def _draw_skills(axes: Any, timeline: Timeline, colours: Sequence[str]) -> None:
    for segment in timeline.answer.segments:
        start, end = timeline.time_s[segment.start], timeline.time_s[segment.end]
        colour = colours[timeline.answer.skills.index(segment.skill)]
        axes.axvspan(start, end, color=colour, linewidth=0)
    axes.set(xlim=(timeline.time_s[0], timeline.time_s[-1]), xticks=[], yticks=[], facecolor=_NONE)
    axes.set_ylabel("skill", rotation=0, ha="right", va="center")
    axes.spines[:].set_visible(False)
