"""The demo's pictures, drawn with matplotlib."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.cli.demo.report import Measured

Image = npt.NDArray[np.uint8]

_INK, _PAPER, _FAINT, _QUIET = "#1f2430", "#ffffff", "#8b93a3", "#cfd6e4"
_GOOD, _BAD = "#2f9e58", "#d63a3a"
_SKILL_COLOURS = {
    "red": "#d63a3a",
    "green": "#2f9e58",
    "yellow": "#e8b50c",
    "blue": "#2f6fde",
    "purple": "#8a4fd0",
    "magenta": "#c2399f",
    "orange": "#e8772e",
    "cyan": "#17a3b0",
}
_OTHER_COLOURS = ("#4c6a92", "#a06a3f", "#5a8f7b", "#7a5c86", "#b0574f")
_FILM_FRAMES = 9
_GREATEST_OVERLAY = 0.75
_SMOOTHING_REACH = 7  # iterations to either side: those in which every environment has ended some episodes


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
        similarities: float32 (texts,), similarity of the image and each text.
        truth: Index of the true text.
    """

    image: Image
    phrases: Sequence[str]
    heatmaps: Sequence[npt.NDArray[np.float32]]
    pixels: Sequence[tuple[float, float]]
    texts: Sequence[str]
    similarities: npt.NDArray[np.float32]
    truth: int


def draw_timeline(path: Path, trajectory: LabelledTrajectory, *, task: str) -> None:
    """Writes a PNG of a labelled trajectory: frames, true skills, predicted skills, confidence."""
    figure = _figure(
        5.4,
        f"Which skill when: the held-out trajectory of median accuracy, {task}",
        f"{trajectory.accuracy:.1%} of {len(trajectory.truth)} timesteps right; "
        "learned from the set of skills per trajectory",
        left=0.085,
        top=0.86,
    )
    rows = figure.subplots(4, 1, gridspec_kw={"height_ratios": [2.3, 0.8, 0.8, 1.2], "hspace": 0.28})
    figure.subplots_adjust(right=0.985, bottom=0.16)
    _draw_film(rows[0], trajectory.frames)
    _draw_labels(rows[1], "truth", trajectory.truth, trajectory.skills)
    _draw_labels(rows[2], "predicted", trajectory.labels, trajectory.skills)
    _draw_confidence(rows[3], trajectory)
    _draw_legend(figure, trajectory)
    figure.savefig(path)


def draw_filmstrip(path: Path, goals: Sequence[FilmstripGoal]) -> None:
    """Writes a PNG with each goal image above what the robot saw when its pursuit ended."""
    figure = _figure(
        4.7,
        "Following goal images never seen",
        "robot of median success: what it saw when it went on to the next goal, and its confidence; "
        "green: truly there; learned from random exploration",
        left=0.07,
        top=0.80,
    )
    rows = figure.subplots(2, len(goals), squeeze=False)
    figure.subplots_adjust(right=0.99, bottom=0.07, wspace=0.06, hspace=0.06)
    for column, one in enumerate(goals):
        for axes, image, edge in zip(
            rows[:, column], (one.goal, one.seen), (_FAINT, _GOOD if one.reached else _BAD), strict=True
        ):
            axes.imshow(image, interpolation="nearest")
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set(color=edge, linewidth=2.5)
        rows[1][column].set_xlabel(f"step {one.step} · {one.confidence:.2f}", fontsize=11, color=_INK, labelpad=5)
    for row, name in zip(rows, ("goal", "seen"), strict=True):
        row[0].set_ylabel(name, rotation=0, ha="right", va="center", fontsize=12, color=_INK, labelpad=8)
    figure.savefig(path)


def draw_rewards(path: Path, examples: Sequence[RewardExample]) -> None:
    """Writes a PNG with a row per image: the image, the heatmap of each phrase, the similarity of each text."""
    height = 2.5 * len(examples) + 1.1
    figure = _figure(
        height,
        "Where the things are, and which sentence fits best",
        "first held-out image of each relation, of two blocks and of four; green: the true sentence wins; "
        "learned from unlabelled images and noun phrases",
        left=0.02,
        top=1 - 0.95 / height,
    )
    columns = 1 + len(examples[0].phrases) + 1
    ratios = [1.0] * (columns - 1) + [2.2]
    rows = figure.subplots(len(examples), columns, squeeze=False, gridspec_kw={"width_ratios": ratios, "wspace": 0.08})
    figure.subplots_adjust(right=0.98, bottom=0.25 / height, hspace=0.16)
    for axes, one in zip(rows, examples, strict=True):
        _draw_image(axes[0], one.image, "")
        for column, (phrase, heatmap, pixel) in enumerate(zip(one.phrases, one.heatmaps, one.pixels, strict=True), 1):
            _draw_image(axes[column], _overlaid(one.image, heatmap), phrase)
            axes[column].plot(*pixel, "+", color=_PAPER, markersize=14, markeredgewidth=2.2)
        _draw_similarities(axes[-1], one)
    figure.savefig(path)


def draw_returns(path: Path, curve: Sequence[tuple[int, float]], bars: Mapping[str, Mapping[str, Measured]]) -> None:
    """Writes a PNG of a training: its learned return by iteration, and beside it panels of oracle returns by policy."""
    figure = _figure(
        5.2,
        "PPO from random weights, then distillation into a policy that is told in words what to do",
        "control steps of 100 at the goal by true states, in the same 50 episodes each; lines are 95 % intervals",
        left=0.05,
        top=0.78,
    )
    left, *panels = figure.subplots(
        1, 1 + len(bars), gridspec_kw={"width_ratios": [1.2, *(1.0 for _ in bars)], "wspace": 0.14}
    )
    figure.subplots_adjust(right=0.985, bottom=0.12)
    _draw_curve(left, curve)
    top = 1.1 * max(each.high or each.value for group in bars.values() for each in group.values())
    for panel, (name, group) in zip(panels, bars.items(), strict=True):
        _draw_bars(panel, group, name=name, top=top)
    figure.savefig(path)


def _figure(height: float, title: str, subtitle: str, *, left: float, top: float) -> Any:
    """Returns a figure with a title and a subtitle above `top`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, height), dpi=140, facecolor=_PAPER)
    figure.subplots_adjust(left=left, top=top)
    figure.text(left, 1 - 0.38 / height, title, fontsize=16, fontweight="bold", color=_INK)
    figure.text(left, 1 - 0.68 / height, subtitle, fontsize=11, color=_FAINT)
    return figure


def _skill_colour(skill: str, index: int) -> str:
    """Returns the colour that a skill's name mentions, else one by its index."""
    words = skill.replace("_", "-").split("-")
    named = (_SKILL_COLOURS[word] for word in words if word in _SKILL_COLOURS)
    return next(named, _OTHER_COLOURS[index % len(_OTHER_COLOURS)])


def _draw_film(axes: Any, frames: Image) -> None:
    picks = ((np.arange(_FILM_FRAMES) + 0.5) * len(frames) / _FILM_FRAMES).astype(int)
    height, width = frames.shape[1:3]
    gap = max(1, width // 24)
    strip = np.full((height, _FILM_FRAMES * (width + gap) - gap, 3), 255, np.uint8)
    for place, pick in enumerate(picks):
        strip[:, place * (width + gap) : place * (width + gap) + width] = frames[pick]
    _draw_image(axes, strip, "")


def _draw_labels(axes: Any, name: str, labels: npt.NDArray[np.int64], skills: tuple[str, ...]) -> None:
    starts = np.flatnonzero(np.diff(labels, prepend=-1))
    lengths = np.diff(np.append(starts, len(labels)))
    colours = [_skill_colour(skills[skill], skill) for skill in labels[starts].tolist()]
    axes.barh(0, lengths, left=starts, height=1, color=colours, edgecolor=_PAPER, linewidth=1.5)
    axes.set(xlim=(0, len(labels)), ylim=(-0.5, 0.5), yticks=[], xticks=[])
    axes.set_ylabel(name, rotation=0, ha="right", va="center", fontsize=12, color=_INK)
    axes.spines[:].set_visible(False)


def _draw_confidence(axes: Any, trajectory: LabelledTrajectory) -> None:
    steps = np.arange(len(trajectory.confidence)) + 0.5
    axes.fill_between(steps, trajectory.confidence, color=_QUIET, linewidth=0)
    axes.plot(steps, trajectory.confidence, color=_INK, linewidth=1.4)
    wrong = np.flatnonzero(trajectory.labels != trajectory.truth)
    axes.plot(wrong + 0.5, np.full(len(wrong), 0.04), "|", color=_BAD, markersize=7)
    axes.set(xlim=(0, len(steps)), ylim=(0, 1.05), yticks=[0, 1])
    axes.set_ylabel("confidence", rotation=0, ha="right", va="center", fontsize=12, color=_INK)
    axes.set_xlabel("timestep", fontsize=11, color=_FAINT)
    _style_axes(axes)


def _draw_legend(figure: Any, trajectory: LabelledTrajectory) -> None:
    from matplotlib.patches import Patch

    used = sorted(set(trajectory.truth.tolist()) | set(trajectory.labels.tolist()))
    skills = trajectory.skills
    handles = [Patch(color=_skill_colour(skills[index], index), label=skills[index]) for index in used]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, fontsize=11, labelcolor=_INK)


def _draw_image(axes: Any, image: Image, name: str) -> None:
    axes.imshow(image, interpolation="nearest")
    axes.set_title(name, fontsize=10.5, color=_INK, pad=4)
    axes.axis("off")


def _overlaid(image: Image, heatmap: npt.NDArray[np.float32]) -> Image:
    """Returns the image under its heatmap."""
    from matplotlib import colormaps

    warm = colormaps["inferno"](heatmap)[..., :3] * 255
    share = _GREATEST_OVERLAY * heatmap[..., None]
    return np.asarray(image * (1 - share) * 0.6 + warm * (0.4 * (1 - share) + share), np.uint8)


def _draw_similarities(axes: Any, one: RewardExample) -> None:
    """Draws a bar per text; the winner is green where it is true, else red, and the true text is marked."""
    winner, places = int(np.argmax(one.similarities)), np.arange(len(one.texts))
    colours = [_QUIET] * len(one.texts)
    colours[winner] = _GOOD if winner == one.truth else _BAD
    axes.barh(places, one.similarities, color=colours, height=0.72)
    axes.axvline(0, color=_FAINT, linewidth=0.8)
    left = axes.get_xlim()[0]
    for place, text in enumerate(one.texts):
        weight = "bold" if place == winner else "normal"
        mark = " (true)" if place == one.truth != winner else ""
        axes.text(left, place, f" {text}{mark}", va="center", fontsize=10, color=_INK, fontweight=weight)
    axes.set(yticks=[], xticks=[])
    axes.invert_yaxis()
    axes.spines[:].set_visible(False)


def _draw_curve(axes: Any, curve: Sequence[tuple[int, float]]) -> None:
    """Draws the returns, faint, and their moving average."""
    iterations, returns = np.array(curve).T
    near = np.abs(iterations[:, None] - iterations) <= _SMOOTHING_REACH
    axes.fill_between(iterations, returns, color=_QUIET, alpha=0.6, linewidth=0)
    axes.plot(iterations, near @ returns / near.sum(axis=1), color=_INK, linewidth=2.2)
    axes.set(xlim=(iterations[0], iterations[-1]), ylim=(0, None))
    axes.set_xlabel("iterations", fontsize=11, color=_FAINT)
    axes.set_title("return by the learned reward", fontsize=12, color=_INK, loc="left")
    _style_axes(axes)


def _draw_bars(axes: Any, bars: Mapping[str, Measured], *, name: str, top: float) -> None:
    means = np.array([each.value for each in bars.values()])
    low, high = np.transpose([each.interval or (each.value, each.value) for each in bars.values()])
    axes.bar(list(bars), means, yerr=(means - low, high - means), color=_QUIET, width=0.62, ecolor=_INK, capsize=5)
    axes.set_title(name, fontsize=12, color=_INK, loc="left")
    axes.set(ylim=(0, top))
    _style_axes(axes)
    axes.tick_params(axis="x", labelsize=9.5, labelcolor=_INK)


def _style_axes(axes: Any) -> None:
    axes.tick_params(colors=_FAINT, labelsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_FAINT)
