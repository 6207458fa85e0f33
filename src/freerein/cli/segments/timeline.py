"""A labelled trajectory, and its timeline in the terminal."""

from collections.abc import Sequence
from dataclasses import dataclass
from string import ascii_uppercase

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table
from rich.text import Text

from freerein.types.segmentation import FLAGGED, NO_SKILL, SegmentResponse

_COLOURS = ("cyan", "magenta", "yellow", "green", "blue", "red", "bright_cyan", "bright_magenta")
_WIDEST_BAR = 100
_MOST_FLAGGED = 0.1
"""Share of timesteps up to which a trajectory like those of the fit may be flagged: on average `FLAGGED` are."""
_ONE_FRAME_S = 0.1


@dataclass(frozen=True, eq=False)
class Timeline:
    """The answer for a trajectory, and when its timesteps are.

    Attributes:
        answer: The answer.
        time_s: float64 (T + 1,), when each timestep begins, and the last one ends, in seconds.
        note: A sentence to show below it; may be empty.
    """

    answer: SegmentResponse
    time_s: npt.NDArray[np.float64]
    note: str = ""

    @property
    def cues(self) -> list[tuple[float, float, str]]:
        """When each segment starts and ends, in seconds, and its skill."""
        return [(self.time_s[each.start], self.time_s[each.end], each.skill) for each in self.answer.segments]


def at_rate(answer: SegmentResponse, *, fps: float) -> Timeline:
    """Returns the timeline of a trajectory with a constant number of timesteps per second."""
    return Timeline(answer, np.arange(len(answer.labels) + 1) / fps)


def of_video(answer: SegmentResponse) -> Timeline:
    """Returns the timeline of a video; its last timestep lasts as long as the others do at the median."""
    time_s = answer.time_s.astype(np.float64)
    last = float(np.median(np.diff(time_s))) if len(time_s) > 1 else _ONE_FRAME_S
    return Timeline(answer, np.append(time_s, time_s[-1] + last))


def show(timeline: Timeline, console: Console) -> None:
    """Prints the segments as a table, and the trajectory as a bar."""
    answer = timeline.answer
    header = ("", "skill", "from", "to", "seconds", "confidence")
    table = Table(*header, box=None, header_style="bold", pad_edge=False)
    for segment in answer.segments:
        mark = _mark(answer.skills.index(segment.skill))
        seconds = f"{timeline.time_s[segment.start]:.2f} - {timeline.time_s[segment.end]:.2f}"
        numbers = (str(segment.start), str(segment.end), seconds, f"{segment.confidence:.2f}")
        table.add_row(mark, Text(segment.skill), *numbers)
    console.print(table)
    console.print(skill_bar(answer.labels.tolist(), width=min(console.width, _WIDEST_BAR)))
    rejected = int((answer.labels == NO_SKILL).sum())
    rate = f", {answer.fps:g} per second" if answer.fps else ""
    console.print(
        f"{len(answer.labels)} timesteps{rate}, {f'{rejected} of them rejected, ' if rejected else ''}"
        f"model {answer.model.name} {answer.model.version}",
        style="dim",
    )
    for text in filter(None, (warning(flagged([answer.in_distribution])), timeline.note)):
        console.print(text)


def flagged(in_distribution: Sequence[npt.NDArray[np.float32]]) -> float:
    """Returns the share of timesteps that are probably unlike what the model was fitted on; 0 without a timestep.

    Scores of each trajectory are float32 (T,).
    """
    scores = np.concatenate([np.empty(0, np.float32), *in_distribution])
    return float((scores < FLAGGED).mean()) if len(scores) else 0.0


def warning(share: float) -> str:
    """Returns a sentence where the share of flagged timesteps is more than chance makes it, else nothing."""
    if share <= _MOST_FLAGGED:
        return ""
    return (
        f"{share:.0%} of the timesteps are probably unlike what the model was fitted on: `in_distribution` is below "
        f"{FLAGGED:g}, as for {FLAGGED:.0%} of held-out ones."
    )


def rate_warning(fps: float, trained: float) -> str:
    """Returns a sentence where a dataset has other timesteps per second than what a model was trained on, if known."""
    if not trained or fps == trained:
        return ""
    return (
        f"The dataset has {fps:g} timesteps per second, and the model was trained on {trained:g}: name another model, "
        f"or import videos with --fps {trained:g}."
    )


def skill_bar(labels: Sequence[int], *, width: int) -> Text:
    """Returns a trajectory as a line of at most `width` letters: A in its own colour for skill 0, a dot for none."""
    cells = min(width, len(labels))
    return Text.assemble(*(_mark(labels[cell * len(labels) // cells]) for cell in range(cells)))


def _mark(skill: int) -> Text:
    if skill == NO_SKILL:
        return Text("·", style="dim")
    return Text(ascii_uppercase[skill % len(ascii_uppercase)], style=f"black on {_COLOURS[skill % len(_COLOURS)]}")
