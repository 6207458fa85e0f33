"""The demo's table: which figures of which steps, and the bars that they must meet."""

from collections.abc import Mapping
from dataclasses import dataclass

from freerein.cli.demo.pipeline import SIDES
from freerein.cli.demo.report import Figure, Returns
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
_ROWS = (
    *(
        _Row(f"reward.{step.replace('-', '_')}.{figure}", step, figure, guess, beats_baseline=True)
        for step in ("two-blocks", "four-blocks")
        for figure, guess in (("accuracy", "majority guess"), ("balanced_accuracy", "constant guess"))
    ),
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


@dataclass(frozen=True)
class Student:
    """A policy that is told in words what to do: its oracle returns by the sides of the task and of the sentence."""

    returns: Mapping[tuple[str, str], Returns]

    @property
    def own_sentence(self) -> Returns:
        """Returns over both tasks, each told its own sentence."""
        return self.returns["left", "left"] + self.returns["right", "right"]

    @property
    def word_blind(self) -> Returns:
        """Returns over both tasks, always told the same sentence: the better of the two."""
        constant = [self.returns["left", told] + self.returns["right", told] for told in SIDES]
        return max(constant, key=lambda returns: returns.mean)


def student_of(results: Results) -> Student:
    """Returns the returns of the student."""
    return Student({(side, told): results.returns(f"{side}-told-{told}") for side in SIDES for told in SIDES})


def figures(results: Results, *, total_s: float) -> tuple[Figure, ...]:
    """Returns the table's rows; returns are control steps of 100 at the goal."""
    labels, grid = results.figure("blocks-labels", "frame_accuracy"), results.figure("grid-labels", "frame_accuracy")
    return (
        _figure("segmentation.frame_accuracy", labels, _LONGEST_SKILL, at_least=(labels["baseline"] or 0) + 0.25),
        _figure("grid.frame_accuracy", grid, _LONGEST_SKILL, at_least=0.99),
        *(
            _figure(
                row.name, results.figure(row.step, row.figure), row.baseline_text, beats_baseline=row.beats_baseline
            )
            for row in _ROWS
        ),
        *_policy_figures(results),
        Figure("ppo.training_s", results.seconds("ppo")),
        Figure("distill.training_s", results.seconds("distill")),
        Figure("total_s", total_s, at_most=_LONGEST_S),
    )


def _policy_figures(results: Results) -> list[Figure]:
    """Returns the figures of PPO and of distillation."""
    checkpoint, ppo, student = results.returns("checkpoint"), results.returns("ppo-returns"), student_of(results)
    random = {side: results.returns(f"random-{side}").mean for side in SIDES}
    right, blind = student.own_sentence, student.word_blind
    return [
        _returns_figure("ppo.checkpoint_return", checkpoint, random["left"], "random actions"),
        _returns_figure("ppo.return", ppo, checkpoint.mean, "shipped checkpoint"),
        _returns_figure("ppo.gain_since_checkpoint", ppo - checkpoint, 0.0, "no gain", beats_baseline=True),
        *(
            _returns_figure(f"distill.{side}_of.told_{told}", returns, random[side], "random actions")
            for (side, told), returns in student.returns.items()
        ),
        _returns_figure("distill.own_sentence_return", right, blind.mean, "one constant sentence"),
        _returns_figure("distill.gain_by_words", right - blind, 0.0, "word-blind", beats_baseline=True),
    ]


def _figure(
    name: str,
    measured: Mapping[str, float | None],
    baseline_text: str,
    *,
    at_least: float | None = None,
    beats_baseline: bool = False,
) -> Figure:
    low, high = measured["low"], measured["high"]
    return Figure(
        name,
        measured["value"] or 0.0,
        measured["baseline"],
        baseline_text,
        None if low is None or high is None else (low, high),
        at_least=at_least,
        beats_baseline=beats_baseline,
    )


def _returns_figure(
    name: str, returns: Returns, baseline: float, baseline_text: str, *, beats_baseline: bool = False
) -> Figure:
    return Figure(name, returns.mean, baseline, baseline_text, returns.interval, beats_baseline=beats_baseline)
