"""The demo's table: which figures of which steps, and the bars that they must meet."""

from dataclasses import dataclass, replace

from freerein.cli.demo.pipeline import SIDES
from freerein.cli.demo.report import Figure, Measured
from freerein.cli.demo.results import Results

_LONGEST_S = 600.0
_EXPERT_RETURN = 75.0
"""What a task must allow: the scripted expert's return, of 100."""


@dataclass(frozen=True)
class _Row:
    """A row of the table.

    Attributes:
        name: Its name in the table.
        step: The step that measures it.
        figure: Its name in the step's result.
        baseline_text: The trivial answer, in words; empty for none.
        at_least: Bar that it must reach.
        at_most: Bar that it must not exceed.
        beats_baseline: Whether the baseline is the bar.
    """

    name: str
    step: str
    figure: str
    baseline_text: str = ""
    at_least: float | None = None
    at_most: float | None = None
    beats_baseline: bool = False


_LONGEST_SKILL = "each trajectory's longest skill"
_REWARD_BARS = {"two-blocks": 0.93, "four-blocks": 0.85}
"""Least balanced accuracy of the reward among the five relations, by the step that measures it."""

_ROWS = (
    _Row("imitation.landmarks_reached", "landmarks", "landmarks_reached", "random actions", beats_baseline=True),
    _Row("imitation.landmarks_free", "landmarks", "no_object_moves.landmarks_recognized", at_least=0.85),
    _Row("imitation.landmarks_block", "landmarks", "object_moves.landmarks_recognized", at_least=0.55),
    _Row("imitation.goal_auroc", "landmarks", "visited.goal_auroc", "chance", at_least=0.95),
    _Row("imitation.goal_ece", "landmarks", "visited.goal_ece", at_most=0.05),
    _Row("recipe.skills_completed", "recipes", "skills_completed", "random actions", at_least=0.8),
    _Row("recipe.whole", "recipes", "whole", at_least=0.45),
)


def figures(results: Results, *, total_s: float) -> tuple[Figure, ...]:
    """Returns the table's rows; returns are control steps of 100 at the goal."""
    labels, grid = results.figure("blocks-labels", "frame_accuracy"), results.figure("grid-labels", "frame_accuracy")
    return (
        _figure("segmentation.frame_accuracy", labels, _LONGEST_SKILL, at_least=(labels.baseline or 0) + 0.25),
        _figure("grid.frame_accuracy", grid, _LONGEST_SKILL, at_least=0.99),
        *(figure for step, bar in _REWARD_BARS.items() for figure in _reward_figures(results, step, at_least=bar)),
        *(_row_figure(results, row) for row in _ROWS),
        *policy_figures(results),
        Figure("ppo.training_s", results.seconds("ppo")),
        Figure("distill.training_s", results.seconds("distill")),
        Figure("total_s", total_s, at_most=_LONGEST_S),
    )


def _reward_figures(results: Results, step: str, *, at_least: float) -> tuple[Figure, ...]:
    """Returns how often the reward names the true relation, and how often whoever always names the commonest does."""
    name = f"reward.{step.replace('-', '_')}"
    accuracy, balanced = (results.figure(step, figure) for figure in ("accuracy", "balanced_accuracy"))
    return (
        _figure(f"{name}.accuracy", accuracy, "majority guess", beats_baseline=True),
        Figure(f"{name}.majority", accuracy.baseline or 0.0),
        _figure(f"{name}.balanced_accuracy", balanced, "constant guess", at_least=at_least),
    )


def policy_figures(results: Results) -> list[Figure]:
    """Returns the figures of PPO and of distillation."""
    random = {side: results.figure(f"random-{side}", "return_mean").value for side in SIDES}
    first, last, expert = (
        results.figure("ppo-returns", name) for name in ("baseline_return_mean", "return_mean", "expert_return_mean")
    )
    own, word_blind, gain = (
        results.figure("sentences", name) for name in ("own_text_return", "word_blind", "gain_by_words")
    )
    return [
        _figure("ppo.return_first", replace(first, baseline=random["left"]), "random actions"),
        _figure(
            "ppo.return_last", replace(last, baseline=first.high), "upper end of return_first", beats_baseline=True
        ),
        Figure("ppo.expert_return", expert.value, interval=expert.interval, at_least=_EXPERT_RETURN),
        *(
            _figure(f"distill.{side}_of.told_{told}", replace(returns, baseline=random[side]), "random actions")
            for (side, told), returns in results.told().items()
        ),
        _figure("distill.own_sentence_return", own, "one constant sentence"),
        Figure("distill.word_blind", word_blind.value, interval=word_blind.interval, at_most=own.low),
        _figure("distill.gain_by_words", gain, "word-blind", beats_baseline=True),
    ]


def _row_figure(results: Results, row: _Row) -> Figure:
    return _figure(
        row.name,
        results.figure(row.step, row.figure),
        row.baseline_text,
        at_least=row.at_least,
        at_most=row.at_most,
        beats_baseline=row.beats_baseline,
    )


def _figure(
    name: str,
    measured: Measured,
    baseline_text: str,
    *,
    at_least: float | None = None,
    at_most: float | None = None,
    beats_baseline: bool = False,
) -> Figure:
    return Figure(
        name,
        measured.value,
        measured.baseline if baseline_text else None,
        baseline_text,
        measured.interval,
        at_least=at_least,
        at_most=at_most,
        beats_baseline=beats_baseline,
    )
