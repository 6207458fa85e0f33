"""The demo's pictures, by what is drawn where."""

import itertools
from typing import Any

import numpy as np
import pytest

from freerein.cli.demo.evaluations import Evaluation, filmstrip_failure
from freerein.cli.demo.pictures import (
    FilmstripGoal,
    LabelledTrajectory,
    RewardExample,
    filmstrip_figure,
    rewards_figure,
    timeline_figure,
)
from freerein.cli.figure_style import BAD, GOOD, figure_style, skill_colours

RNG = np.random.default_rng(0)
TEXTS = ("a yellow block to the right of a green block", "a yellow block or a green block missing", "short")


def pixels(height: int, width: int) -> np.ndarray:
    return RNG.integers(0, 256, (height, width, 3), dtype=np.uint8)


def example(similarities: list[float]) -> RewardExample:
    heatmaps = [RNG.random((8, 8), dtype=np.float32)] * 2
    return RewardExample(
        pixels(8, 8), ("a", "b"), heatmaps, [(1, 1), (2, 2)], TEXTS, np.array(similarities, np.float32), 0
    )


def drawn(figure: Any) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure).draw()
    return figure


@pytest.mark.parametrize(("similarities", "edge"), [([0.9, -0.9, 0.1], GOOD), ([-0.2, 0.9, -0.9], BAD)])
def test_the_true_sentence_is_marked_and_no_text_crosses_a_bar(similarities: list[float], edge: str) -> None:
    figure = drawn(rewards_figure([example(similarities), example([0.0, 0.5, 1.0])], images="two"))
    texts, bars = figure.axes[3].texts, figure.axes[4].patches
    assert [text.get_text() for text in texts] == [f"\N{CHECK MARK} {TEXTS[0]}", *TEXTS[1:]]
    winner = bars[int(np.argmax(similarities))]
    assert winner.get_facecolor() == pytest.approx((*tuple(int(edge[at : at + 2], 16) / 255 for at in (1, 3, 5)), 1.0))
    ends = [text.get_window_extent().x1 for text in texts]
    assert max(ends) < min(bar.get_window_extent().x0 for bar in bars)
    assert min(text.get_window_extent().x0 for text in texts) > figure.axes[2].get_window_extent().x1
    middles = [np.mean(each.get_window_extent().get_points()[:, 1]) for each in (*texts, *bars)]
    assert middles[:3] == pytest.approx(middles[3:], abs=3)


@pytest.mark.parametrize(("count", "height", "width"), [(2, 64, 64), (4, 64, 64), (7, 48, 64)])
def test_a_filmstrip_fills_the_width(count: int, height: int, width: int) -> None:
    goals = [FilmstripGoal(pixels(height, width), pixels(height, width), 3, 0.5, True)] * count
    figure = drawn(filmstrip_figure(goals))
    boxes = [axes.get_window_extent() for axes in figure.axes]
    page = figure.bbox.width
    assert boxes[count - 1].x1 == pytest.approx(0.99 * page, abs=3)
    assert boxes[0].x0 == pytest.approx(0.06 * page, abs=3)
    gaps = [after.x0 - before.x1 for before, after in itertools.pairwise(boxes)]
    assert max(gaps) < 0.07 * boxes[0].width


def test_similarities_of_all_images_have_one_scale_which_the_last_one_names() -> None:
    figure = drawn(rewards_figure([example([0.9, -0.9, 0.1]), example([0.0, 0.05, 0.1])], images="two"))
    first, last = figure.axes[4], figure.axes[9]
    assert first.get_xlim() == last.get_xlim() == pytest.approx((-0.945, 0.945))
    assert (first.get_xlabel(), last.get_xlabel()) == ("", "cosine similarity")
    assert len(first.get_xticks()) == 0 < len(last.get_xticks())


def test_the_robot_of_least_success_is_shown_below_that_of_median_success() -> None:
    from matplotlib.colors import to_rgba

    reached, missed = (FilmstripGoal(pixels(64, 64), pixels(64, 64), 9, 0.5, each) for each in (True, False))
    figure = drawn(filmstrip_figure([reached] * 4, [reached, missed]))
    above, below = figure.axes[:8], figure.axes[8:]
    assert [axes.spines["left"].get_edgecolor() for axes in (above[4], below[5])] == [to_rgba(GOOD), to_rgba(BAD)]
    assert below[4].get_ylabel().split() == ["seen,", "worst", "robot"]
    assert below[5].get_xlabel() == "step 9 · confidence 0.50"
    assert max(axes.get_window_extent().y1 for axes in below) < min(axes.get_window_extent().y0 for axes in above)
    assert not below[7].axison
    assert all(axes.yaxis.label.get_window_extent().x0 > 0 for axes in figure.axes if axes.get_ylabel())
    assert above[0].get_window_extent().width == pytest.approx(below[0].get_window_extent().width, abs=2)


def test_a_filmstrip_has_the_worst_robot_only_where_the_evaluation_kept_one() -> None:
    frames = {name: np.stack([pixels(8, 8)] * 2) for name in ("goals", "ends", "worst_goals", "worst_ends")}
    pursuits = [{"landmark": n, "step": n, "confidence": 0.5, "at_landmark": not n} for n in range(2)]
    kept = Evaluation({"worst_pursuits": pursuits}, pursuits, frames)
    assert [each.reached for each in filmstrip_failure(kept)] == [True, False]
    assert filmstrip_failure(Evaluation({}, pursuits, {name: frames[name] for name in ("goals", "ends")})) == ()


def test_a_timeline_names_what_it_shows() -> None:
    labels = np.repeat([0, 1], 10)
    trajectory = LabelledTrajectory(
        np.broadcast_to(pixels(8, 8), (20, 8, 8, 3)),
        labels,
        labels[::-1],
        np.ones(20, np.float32),
        ("reach", "pour"),
        0.0,
    )
    figure = drawn(timeline_figure(trajectory, task="kitchen"))
    (legend,) = figure.legends
    assert figure.texts[0].get_text().startswith("Skill timeline")
    assert (legend.get_title().get_text(), [text.get_text() for text in legend.get_texts()]) == (
        "Skill",
        ["reach", "pour"],
    )


def test_skills_have_the_colour_that_they_name_and_others_colours_of_their_own() -> None:
    with figure_style():
        colours = skill_colours(["move-red", "reach", "pour", "push_blue"])
    assert colours[0] == "#d63a3a"
    assert colours[3] == "#2f6fde"
    assert len(set(colours)) == 4
