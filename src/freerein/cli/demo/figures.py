"""The demo's table: which figures of which steps, and the bars that they must meet."""

from dataclasses import dataclass, replace

from freerein.cli.demo.pipeline import SIDES
from freerein.cli.demo.report import Figure, Measured
from freerein.cli.demo.results import Results

_LONGEST_S = 600.0


@dataclass(frozen=True)
class _Row:
    """A row of the table.

    Attributes:
        name: Its name in the table.
        step: The step that measures it.
        figure: Its name in the step's result.
        baseline_text: The trivial answer, in words; empty for none.
        beats_baseline: Whether the baseline is the bar.
    """

    name: str
    step: str
    figure: str
    baseline_text: str = ""
    beats_baseline: bool = False


_LONGEST_SKILL = "each trajectory's longest skill"
_REWARD_BARS = {"two-blocks": 0.93, "four-blocks": 0.85}
"""Least balanced accuracy of the reward among the five relations, by the step that measures it."""

_ROWS = (
    *(
        _Row(
            f"imitation.{name}landmarks_reached",
            "landmarks",
            f"{split}landmarks_reached",
            "random actions",
            beats_baseline=True,
        )
        for name, split in (("", ""), ("no_block_moves.", "no_object_moves."), ("block_moves.", "object_moves."))
    ),
    _Row("imitation.landmarks_recognized", "landmarks", "landmarks_recognized"),
    _Row("imitation.visited.at_landmark", "landmarks", "visited.at_landmark"),
    _Row("imitation.visited.goal_auroc", "landmarks", "visited.goal_auroc", "chance", beats_baseline=True),
    _Row("imitation.visited.goal_ece", "landmarks", "visited.goal_ece", "always the base rate"),
    _Row("recipe.skills_completed", "recipes", "skills_completed", "random actions", beats_baseline=True),
    _Row("recipe.blocks_lifted", "recipes", "skills_lifted", "random actions"),
)


def figures(results: Results, *, total_s: float) -> tuple[Figure, ...]:
    """Returns the table's rows; returns are control steps of 100 at the goal."""
    labels, grid = results.figure("blocks-labels", "frame_accuracy"), results.figure("grid-labels", "frame_accuracy")
    return (
        _figure("segmentation.frame_accuracy", labels, _LONGEST_SKILL, at_least=(labels.baseline or 0) + 0.25),
        _figure("grid.frame_accuracy", grid, _LONGEST_SKILL, at_least=0.99),
        *(figure for step, bar in _REWARD_BARS.items() for figure in _reward_figures(results, step, at_least=bar)),
        *(
            _figure(
                row.name, results.figure(row.step, row.figure), row.baseline_text, beats_baseline=row.beats_baseline
            )
            for row in _ROWS
        ),
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
    checkpoint = replace(results.figure("ppo-returns", "baseline_return_mean"), baseline=random["left"])
    ppo, gain = (results.figure("ppo-returns", name) for name in ("return_mean", "gain"))
    own, gain_by_words = (results.figure("sentences", name) for name in ("own_text_return", "gain_by_words"))
    return [
        _figure("ppo.checkpoint_return", checkpoint, "random actions"),
        _figure("ppo.return", ppo, "shipped checkpoint"),
        _figure("ppo.gain_since_checkpoint", gain, "no gain", beats_baseline=True),
        *(
            _figure(f"distill.{side}_of.told_{told}", replace(returns, baseline=random[side]), "random actions")
            for (side, told), returns in results.told().items()
        ),
        _figure("distill.own_sentence_return", own, "one constant sentence"),
        _figure("distill.gain_by_words", gain_by_words, "word-blind", beats_baseline=True),
    ]


def _figure(
    name: str,
    measured: Measured,
    baseline_text: str,
    *,
    at_least: float | None = None,
    beats_baseline: bool = False,
) -> Figure:
    return Figure(
        name,
        measured.value,
        measured.baseline,
        baseline_text,
        measured.interval,
        at_least=at_least,
        beats_baseline=beats_baseline,
    )
