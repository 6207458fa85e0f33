"""The first session: its pipeline in both sizes, and how its figures are judged."""

from dataclasses import replace
from typing import Any

import pytest
from experiments.first_session import EXPERIMENT
from experiments.first_session.figures import Figure, figures
from experiments.first_session.pipeline import FULL, SMALL, TASKS, TEXTS, pipeline
from experiments.first_session.report import session_of, shown
from experiments.workbench.results import ArmResult

from freerein.cli.demo.evaluations import Measured
from freerein_orchestrator.kinds import KINDS

Result = dict[str, Any]
EVALUATIONS = [step["name"] for step in pipeline(FULL, 0) if step["kind"] == "evaluate"]


@pytest.mark.parametrize("size", [FULL, SMALL])
def test_the_orchestrator_takes_the_pipeline_and_its_seed(size: str) -> None:
    steps = pipeline(size, 3)
    KINDS["pipeline"].parse({"steps": [*steps]})
    seeds = [step["config"].get("seed", step["config"].get("config", {}).get("seed")) for step in steps]
    assert dict(zip((step["kind"] for step in steps), seeds, strict=True)) == {
        "collect": 3,
        "fit": 3,
        "evaluate": 1_000_003,
        "label": None,
        "ppo": 3,
        "distill": 3,
    }


def test_the_small_size_has_the_steps_of_the_full_one() -> None:
    full, small = ([(step["name"], step["kind"]) for step in pipeline(size, 0)] for size in (FULL, SMALL))
    assert full == small


@pytest.mark.parametrize(
    ("figure", "bar", "met"),
    [
        (Figure("a", 4, Measured(0.6, None, None, 0.5), "guess", beats_baseline=True), "above baseline", True),
        (Figure("a", 4, Measured(0.5, None, None, 0.5), "guess", beats_baseline=True), "above baseline", False),
        (Figure("a", 4, Measured(9, -1, 20, 0), "guess", beats_baseline=True), "interval above baseline", False),
        (Figure("a", 4, Measured(9, 1, 20, 0), "guess", beats_baseline=True), "interval above baseline", True),
        (Figure("a", 4, Measured(0.9, None, None, None), at_least=0.99), ">= 0.99", False),
        (Figure("a", 4, Measured(0.04, None, None, None), at_most=0.05), "<= 0.05", True),
        (Figure("a", 4, Measured(0.6, None, None, 0.5), "guess"), "", None),
    ],
)
def test_a_bar_is_the_baseline_or_a_number_and_an_interval_must_clear_it(figure: Figure, bar: str, met: bool) -> None:
    assert (figure.bar, figure.met) == (bar, met)


def test_figures_are_those_of_the_evaluations_and_what_a_small_session_lacks_is_left_out() -> None:
    found = {each.name: each for each in figures(session_of(kept()))}
    assert {
        name: (each.measured.value, each.measured.baseline, each.met)
        for name, each in found.items()
        if name.startswith(("segmentation", "ppo", "distill"))
    } == {
        "segmentation.frame_accuracy": (0.5, 0.25, True),
        "ppo.return_first": (7, 1, None),
        "ppo.return_last": (9, 8, False),
        "ppo.expert_return": (80, None, True),
        "distill.left_of.conditioned_on_left": (0, 1, None),
        "distill.left_of.conditioned_on_right": (1, 1, None),
        "distill.right_of.conditioned_on_left": (10, 2, None),
        "distill.right_of.conditioned_on_right": (11, 2, None),
        "distill.own_sentence_return": (6, 5, None),
        "distill.word_blind": (5, None, True),
        "distill.gain_by_words": (0.5, 0, False),
        "ppo.training_s": (81.0, None, None),
        "distill.training_s": (64.0, None, None),
    }
    assert "imitation.landmarks_block" not in found


def test_the_table_has_bars_in_the_full_size_alone() -> None:
    full = EXPERIMENT.table([result(SMALL), result(FULL)])
    small = EXPERIMENT.table([result(SMALL)])
    rows = ({row[0]: row[1:] for row in table.sections[0].rows} for table in (full, small))
    of_full, of_small = (each["ppo.return_last"] for each in rows)
    assert of_full == ("9", "8 to 10", "8 (upper end of return_first)", "interval above baseline", "not met")
    assert of_small == ("9", "8 to 10", "8 (upper end of return_first)", "", "")
    assert next(each for each in full.claims if each.claim == "total_s").value == 600
    assert full.picture.draw().startswith(b"\x89PNG")


def result(size: str) -> ArmResult:
    (arm,) = (each for each in EXPERIMENT.arms if each.options["size"] == size)
    made = ArmResult(arm.name, arm.world, arm.method, arm.options, 0, {}, "blocks-v1", {}, {}, 10.0, 1.0, {}, "run")
    return replace(made, shown=kept())


def kept() -> Result:
    def measured(value: float, baseline: float | None = None) -> dict[str, float | None]:
        return {"value": value, "low": value - 1, "high": value + 1, "baseline": baseline}

    told = [
        {"task": task, "goal_text": text, "return_mean": measured(10 * row + column)}
        for row, task in enumerate(TASKS.values())
        for column, text in enumerate(TEXTS.values())
    ]
    evaluations: dict[str, Result] = {name: {"figures": {}} for name in EVALUATIONS} | {
        "blocks-labels": {"figures": {"frame_accuracy": measured(0.5, 0.25)}},
        "random-left": {"figures": {"return_mean": measured(1)}},
        "random-right": {"figures": {"return_mean": measured(2)}},
        "ppo-returns": {
            "figures": {
                "return_mean": measured(9, 7),
                "baseline_return_mean": measured(7),
                "expert_return_mean": measured(80),
            }
        },
        "sentences": {
            "figures": {
                "own_text_return": measured(6, 5),
                "word_blind": measured(5),
                "gain_by_words": measured(0.5, 0),
            },
            "told": told,
        },
    }
    return shown(
        {name: {**each, "episodes": 4} for name, each in evaluations.items()},
        {"ppo": 81.0, "distill": 64.0},
        [(1, 0.5), (2, 1.5)],
    )
