"""The figures of a session: which figures of which steps, and the bars that they must meet."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from experiments.first_session.pipeline import SIDES
from freerein.cli.demo.evaluations import Measured

_EXPERT_RETURN = 75.0
"""Least return of the scripted expert, of 100."""


@dataclass(frozen=True)
class Figure:
    """One measured value beside what it must be compared with.

    Attributes:
        name: Its name, such as `reward.two_blocks.accuracy`.
        trials: Number of trials that it is measured in.
        measured: The value, with its interval, and with the baseline that it is shown beside.
        baseline_text: The trivial answer that is the baseline, in words.
        at_least: Bar that the value must reach.
        at_most: Bar that the value must not exceed.
        beats_baseline: Whether the bar is the baseline: the value, or its interval's lower end, must exceed it.
    """

    name: str
    trials: int
    measured: Measured
    baseline_text: str = ""
    at_least: float | None = None
    at_most: float | None = None
    beats_baseline: bool = False

    @property
    def met(self) -> bool | None:
        """Whether the bar is met; None where there is none."""
        value, low, baseline = self.measured.value, self.measured.low, self.measured.baseline
        if self.beats_baseline and baseline is not None:
            return (value if low is None else low) > baseline
        if self.at_least is not None:
            return value >= self.at_least
        return None if self.at_most is None else value <= self.at_most

    @property
    def bar(self) -> str:
        """The bar in words; empty where there is none."""
        if self.beats_baseline:
            return "interval above baseline" if self.measured.interval else "above baseline"
        if self.at_least is not None:
            return f">= {self.at_least:.3g}"
        return "" if self.at_most is None else f"<= {self.at_most:.3g}"

    @property
    def target(self) -> float | None:
        """The bar as a number."""
        if self.beats_baseline:
            return self.measured.baseline
        return self.at_most if self.at_least is None else self.at_least


@dataclass(frozen=True)
class Session:
    """The measurements of a session.

    Attributes:
        evaluations: Figures of the evaluations, by step and name.
        trials: Number of trials of each evaluation, by step.
        told: Mean returns of the language policy, by the sides of the task and of the text.
        seconds: Duration of each step.
    """

    evaluations: Mapping[str, Mapping[str, Measured]]
    trials: Mapping[str, int]
    told: Mapping[tuple[str, str], Measured]
    seconds: Mapping[str, float]

    def figure(self, step: str, name: str) -> Measured:
        """Returns a figure of an evaluation."""
        return self.evaluations[step][name]


_LONGEST_SKILL = "each trajectory's longest skill"
_MAJORITY, _CONSTANT = "majority guess", "constant guess"

_ROWS: tuple[tuple[str, str, str, str, Mapping[str, Any]], ...] = (
    ("grid.frame_accuracy", "grid-labels", "frame_accuracy", _LONGEST_SKILL, {"at_least": 0.99}),
    ("reward.two_blocks.accuracy", "two-blocks", "accuracy", _MAJORITY, {"beats_baseline": True}),
    ("reward.two_blocks.balanced_accuracy", "two-blocks", "balanced_accuracy", _CONSTANT, {"at_least": 0.93}),
    ("reward.four_blocks.accuracy", "four-blocks", "accuracy", _MAJORITY, {"beats_baseline": True}),
    ("reward.four_blocks.balanced_accuracy", "four-blocks", "balanced_accuracy", _CONSTANT, {"at_least": 0.85}),
    ("imitation.landmarks_reached", "landmarks", "landmarks_reached", "random actions", {"beats_baseline": True}),
    ("imitation.landmarks_free", "landmarks", "no_object_moves.landmarks_recognized", "", {"at_least": 0.85}),
    ("imitation.landmarks_block", "landmarks", "object_moves.landmarks_recognized", "", {"at_least": 0.55}),
    ("imitation.goal_auroc", "landmarks", "visited.goal_auroc", "chance", {"at_least": 0.95}),
    ("imitation.goal_ece", "landmarks", "visited.goal_ece", "", {"at_most": 0.05}),
    ("recipe.skills_completed", "recipes", "skills_completed", "random actions", {"at_least": 0.8}),
    ("recipe.whole", "recipes", "whole", "", {"at_least": 0.45}),
)
"""Figures of evaluations: name, step, name in the evaluation, trivial answer, and bar."""


def figures(session: Session) -> list[Figure]:
    """Returns the figures in the order of the table; returns are control steps of 100 at the goal.

    Figures that an evaluation could not measure, as in a small size, are left out.
    """
    labels = session.figure("blocks-labels", "frame_accuracy")
    bar = (labels.baseline or 0) + 0.25
    return [
        Figure("segmentation.frame_accuracy", session.trials["blocks-labels"], labels, _LONGEST_SKILL, at_least=bar),
        *_evaluation_figures(session),
        *_policy_figures(session),
        *(
            Figure(f"{step}.training_s", 1, Measured(session.seconds[step], None, None, None))
            for step in ("ppo", "distill")
        ),
    ]


def _evaluation_figures(session: Session) -> Iterator[Figure]:
    """Yields the figures of `_ROWS` that were measured."""
    for name, step, figure, baseline_text, bar in _ROWS:
        if figure in session.evaluations[step]:
            measured = session.figure(step, figure)
            shown = measured if baseline_text else replace(measured, baseline=None)
            yield Figure(name, session.trials[step], shown, baseline_text, **bar)


def _policy_figures(session: Session) -> Iterator[Figure]:
    """Yields the figures of PPO and of distillation."""
    random = {side: session.figure(f"random-{side}", "return_mean").value for side in SIDES}
    first, last, expert = (
        session.figure("ppo-returns", name) for name in ("baseline_return_mean", "return_mean", "expert_return_mean")
    )
    own, word_blind, gain = (
        session.figure("sentences", name) for name in ("own_text_return", "word_blind", "gain_by_words")
    )
    returns, told = session.trials["ppo-returns"], session.trials["sentences"]
    yield Figure("ppo.return_first", returns, replace(first, baseline=random["left"]), "random actions")
    last = replace(last, baseline=first.high)
    yield Figure("ppo.return_last", returns, last, "upper end of return_first", beats_baseline=True)
    yield Figure("ppo.expert_return", returns, replace(expert, baseline=None), at_least=_EXPERT_RETURN)
    for (side, text), mean in session.told.items():
        name = f"distill.{side}_of.conditioned_on_{text}"
        yield Figure(name, told, replace(mean, baseline=random[side]), "random actions")
    yield Figure("distill.own_sentence_return", told, own, "one constant sentence")
    yield Figure("distill.word_blind", told, replace(word_blind, baseline=None), at_most=own.low)
    yield Figure("distill.gain_by_words", told, gain, "word-blind", beats_baseline=True)


def returns_by_panel(session: Session) -> dict[str, Mapping[str, Measured]]:
    """Returns what the picture compares: mean returns by policy, by the title of their panel."""
    random = {side: session.figure(f"random-{side}", "return_mean") for side in SIDES}
    student = {
        side: {f'student,\ngiven "{each}"': session.told[side, each] for each in _own_first(side)} for side in SIDES
    }
    ppo = {
        "untrained": session.figure("ppo-returns", "baseline_return_mean"),
        "ppo": session.figure("ppo-returns", "return_mean"),
        "expert": session.figure("ppo-returns", "expert_return_mean"),
    }
    return {
        "left-of: steps at the goal": {"random": random["left"], **ppo, **student["left"]},
        "right-of: steps at the goal": {"random": random["right"], **student["right"]},
    }


def _own_first(side: str) -> Sequence[str]:
    return sorted(SIDES, key=side.__ne__)
