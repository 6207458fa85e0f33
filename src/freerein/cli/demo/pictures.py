"""Pictures of what models answered, beside the truth, drawn with matplotlib."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from freerein.cli.figure_style import (
    BAD,
    FAINT,
    FILM_FRAMES,
    GOOD,
    INK,
    PAPER,
    QUIET,
    draw_film,
    draw_legend,
    figure_style,
    skill_colours,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Image = npt.NDArray[np.uint8]

RENDERED_PX = 256
"""Height and width of frames that are rendered for a picture, not for a model."""

_WIDTH = 14.0  # inches
_GREATEST_OVERLAY = 0.75


@dataclass(frozen=True, eq=False)
class LabelledTrajectory:
    """A held-out trajectory with true and predicted labels.

    Attributes:
        frames: uint8 (T, H, W, C).
        truth: int64 (T,), indices into `skills`.
        labels: int64 (T,), predicted, likewise.
        confidence: float32 (T,), in [0, 1].
        skills: Names of the skills.
        accuracy: Frame accuracy.
    """

    frames: Image
    truth: npt.NDArray[np.int64]
    labels: npt.NDArray[np.int64]
    confidence: npt.NDArray[np.float32]
    skills: tuple[str, ...]
    accuracy: float


@dataclass(frozen=True, eq=False)
class FilmstripGoal:
    """A goal image and the end of its pursuit.

    Attributes:
        goal: uint8 (H, W, 3), the goal image.
        seen: uint8 (H, W, 3), what the robot saw when the pursuit ended.
        step: Control steps since the episode began.
        confidence: Confidence that the goal was reached, in [0, 1].
        reached: Whether it truly was.
    """

    goal: Image
    seen: Image
    step: int
    confidence: float
    reached: bool


@dataclass(frozen=True, eq=False)
class RewardExample:
    """An image, its groundings, and the similarity of each text.

    Attributes:
        image: uint8 (H, W, 3).
        phrases: Noun phrases.
        heatmaps: float32 (H, W) in [0, 1] per phrase.
        pixels: x and y of each phrase.
        texts: The goal text and its rivals.
        similarities: float32 (texts,), cosine similarity of the image and each text.
        truth: Index of the true text.
    """

    image: Image
    phrases: Sequence[str]
    heatmaps: Sequence[npt.NDArray[np.float32]]
    pixels: Sequence[tuple[float, float]]
    texts: Sequence[str]
    similarities: npt.NDArray[np.float32]
    truth: int


@figure_style()
def timeline_figure(trajectory: LabelledTrajectory, *, task: str) -> "Figure":
    """Returns a labelled trajectory: frames, true skills, predicted skills, confidence."""
    figure = new_figure(
        5.6,
        f"Skill timeline: the held-out trajectory of median accuracy, {task}",
        f"{trajectory.accuracy:.1%} of {len(trajectory.truth)} timesteps right; "
        "learned from the set of skills per trajectory",
        left=0.085,
        top=0.86,
    )
    rows = figure.subplots(4, 1, gridspec_kw={"height_ratios": [2.3, 0.8, 0.8, 1.2], "hspace": 0.28})
    figure.subplots_adjust(right=0.985, bottom=0.21)
    draw_film(rows[0], list(trajectory.frames))
    colours = skill_colours(trajectory.skills)
    _draw_labels(rows[1], "ground truth", trajectory.truth, colours)
    _draw_labels(rows[2], "predicted", trajectory.labels, colours)
    _draw_confidence(rows[3], trajectory)
    used = sorted(set(trajectory.truth.tolist()) | set(trajectory.labels.tolist()))
    draw_legend(figure, [trajectory.skills[index] for index in used], [colours[index] for index in used])
    return figure


@figure_style()
def filmstrip_figure(goals: Sequence[FilmstripGoal], failure: Sequence[FilmstripGoal] = ()) -> "Figure":
    """Returns each goal image above what the robot saw when its pursuit ended, as wide as the figure.

    Args:
        goals: Those of the robot of median success.
        failure: Those of the robot of least success, below; empty for none.
    """
    robots = [goals, failure] if failure else [goals]
    left, right, gap, above, below = 0.06, 0.99, 0.06, 1.0, 0.45  # fractions of the width; then inches
    height, width = goals[0].goal.shape[:2]
    columns = max(map(len, robots))
    side = _WIDTH * (right - left) / (columns + gap * (columns - 1))  # width of an image, inches
    row, between = side * height / width, below + gap * side
    figure = new_figure(
        above + len(robots) * (2 * row + gap * side) + (len(robots) - 1) * between + below,
        "Following goal images never seen",
        "what a robot saw when it went on to the next goal; green: truly there, red: not; learned from random "
        "exploration",
        left=left,
        top=1.0,
    )
    total, top = figure.get_figheight(), above
    for name, shown in zip(("median", "worst"), robots, strict=False):
        rows = figure.add_gridspec(
            2,
            columns,
            left=left,
            right=right,
            top=1 - top / total,
            bottom=1 - (top + 2 * row + gap * side) / total,
            wspace=gap,
            hspace=gap * side / row,
        ).subplots(squeeze=False)
        _draw_pursuits(rows, shown, name)
        top += 2 * row + gap * side + between
    return figure


def _draw_pursuits(rows: Any, goals: Sequence[FilmstripGoal], name: str) -> None:
    """Draws each goal image of a robot above what it saw; `rows` are 2 by as many axes or more."""
    for column, one in enumerate(goals):
        for axes, image, edge in zip(
            rows[:, column], (one.goal, one.seen), (FAINT, GOOD if one.reached else BAD), strict=True
        ):
            axes.imshow(image)
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set(visible=True, color=edge, linewidth=2.5)
        rows[1][column].set_xlabel(f"step {one.step} · confidence {one.confidence:.2f}", labelpad=5)
    for axes in rows[:, len(goals) :].flat:
        axes.axis("off")
    for axes, what in zip(rows[:, 0], ("goal", f"seen,\n{name}\nrobot"), strict=True):
        axes.set_ylabel(what, rotation=0, ha="right", va="center", fontsize=12, labelpad=8)


@figure_style()
def rewards_figure(examples: Sequence[RewardExample], *, images: str) -> "Figure":
    """Returns a row per image: the image, the heatmap of each phrase, the texts, and the similarity of each.

    Args:
        examples: The images.
        images: Says which ones they are.
    """
    height = 2.5 * len(examples) + 1.5
    figure = new_figure(
        height,
        "Where the things are, and which sentence fits best",
        f"{images}; \N{CHECK MARK}: the true sentence; green: it wins, red: another does\n"
        "heat: where the model sees the words, relative to its peak; cross: where it sees them rather than the others",
        left=0.02,
        top=1 - 1.15 / height,
    )
    columns = 1 + len(examples[0].phrases) + 2
    ratios = [1.0] * (columns - 2) + [1.35, 0.95]
    rows = figure.subplots(len(examples), columns, squeeze=False, gridspec_kw={"width_ratios": ratios, "wspace": 0.06})
    figure.subplots_adjust(right=0.98, bottom=0.6 / height, hspace=0.16)
    for axes, one in zip(rows, examples, strict=True):
        _draw_image(axes[0], one.image, "")
        for column, (phrase, heatmap, pixel) in enumerate(zip(one.phrases, one.heatmaps, one.pixels, strict=True), 1):
            _draw_image(axes[column], _overlaid(one.image, heatmap), phrase)
            axes[column].plot(*pixel, "+", color=PAPER, markersize=14, markeredgewidth=2.2)
        _draw_texts(axes[-2], one)
        _draw_similarities(axes[-1], one)
    every = np.concatenate([one.similarities for one in examples])
    limits = 1.05 * min(0.0, float(every.min())), 1.05 * max(0.0, float(every.max()))
    for axes in rows[:, -1]:
        axes.set(xlim=limits, xticks=[])
    rows[-1][-1].xaxis.set_major_locator(_few_ticks())
    rows[-1][-1].set_xlabel("cosine similarity", color=FAINT)
    return figure


@figure_style()
def episode_figure(frames: Sequence[Image], *, title: str, subtitle: str) -> "Figure":
    """Returns some frames of an episode, uint8 (H, W, 3), from its start to its end."""
    height, width = frames[0].shape[:2]
    figure = new_figure(_WIDTH / FILM_FRAMES * height / width + 1.1, title, subtitle, left=0.02, top=0.99)
    figure.subplots_adjust(right=0.98, bottom=0.02, top=1 - 0.95 / figure.get_figheight())
    draw_film(figure.subplots(), frames)
    return figure


def new_figure(height: float, title: str, subtitle: str, *, left: float, top: float) -> "Figure":
    """Returns a figure with a title and a subtitle above `top`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, height))
    figure.subplots_adjust(left=left, top=top)
    figure.text(left, 1 - 0.38 / height, title, fontsize=16, fontweight="bold")
    figure.text(left, 1 - 0.52 / height, subtitle, color=FAINT, va="top")
    return figure


def _draw_labels(axes: Any, name: str, labels: npt.NDArray[np.int64], colours: Sequence[str]) -> None:
    starts = np.flatnonzero(np.diff(labels, prepend=-1))
    lengths = np.diff(np.append(starts, len(labels)))
    of_segments = [colours[skill] for skill in labels[starts].tolist()]
    axes.barh(0, lengths, left=starts, height=1, color=of_segments, edgecolor=PAPER, linewidth=1.5)
    axes.set(xlim=(0, len(labels)), ylim=(-0.5, 0.5), yticks=[], xticks=[])
    axes.set_ylabel(name, rotation=0, ha="right", va="center", fontsize=12)
    axes.spines[:].set_visible(False)


def _draw_confidence(axes: Any, trajectory: LabelledTrajectory) -> None:
    steps = np.arange(len(trajectory.confidence)) + 0.5
    axes.fill_between(steps, trajectory.confidence, color=QUIET, linewidth=0)
    axes.plot(steps, trajectory.confidence, color=INK, linewidth=1.4)
    wrong = np.flatnonzero(trajectory.labels != trajectory.truth)
    axes.plot(wrong + 0.5, np.full(len(wrong), 0.04), "|", color=BAD, markersize=7)
    axes.set(xlim=(0, len(steps)), ylim=(0, 1.05), yticks=[0, 0.5, 1])
    axes.set_ylabel("confidence\n(0 to 1)", rotation=0, ha="right", va="center", fontsize=12)
    axes.set_xlabel("timestep", color=FAINT)


def _draw_image(axes: Any, image: Image, name: str) -> None:
    axes.imshow(image)
    axes.set_title(name, loc="center", pad=4)
    axes.axis("off")


def _overlaid(image: Image, heatmap: npt.NDArray[np.float32]) -> Image:
    """Returns the image under its heatmap."""
    from matplotlib import colormaps

    warm = colormaps["inferno"](heatmap)[..., :3] * 255
    share = _GREATEST_OVERLAY * heatmap[..., None]
    return np.asarray(image * (1 - share) * 0.6 + warm * (0.4 * (1 - share) + share), np.uint8)


def _draw_texts(axes: Any, one: RewardExample) -> None:
    """Writes the texts, each level with its bar; the true one is marked."""
    for place, text in enumerate(one.texts):
        is_true = place == one.truth
        mark, weight = ("\N{CHECK MARK} ", "bold") if is_true else ("", "normal")
        axes.text(1, place, mark + text, ha="right", va="center", fontsize=9.5, fontweight=weight)
    axes.set(xlim=(0, 1), ylim=_level(one))
    axes.axis("off")


def _draw_similarities(axes: Any, one: RewardExample) -> None:
    """Draws a bar per text; the winner is green where it is true, else red."""
    winner = int(np.argmax(one.similarities))
    colours = [QUIET] * len(one.texts)
    colours[winner] = GOOD if winner == one.truth else BAD
    axes.barh(np.arange(len(one.texts)), one.similarities, color=colours, height=0.72)
    axes.axvline(0, color=FAINT, linewidth=0.8)
    axes.set(yticks=[], xticks=[], ylim=_level(one))
    axes.spines[:].set_visible(False)


def _few_ticks() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=4)


def _level(one: RewardExample) -> tuple[float, float]:
    """Returns the vertical limits of texts and bars: the first text is above."""
    return len(one.texts) - 0.5, -0.5
