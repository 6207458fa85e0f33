"""The demo's output folder, its services, and how figures are judged."""

import json
from pathlib import Path

import pytest

from freerein.cli.demo.figures import policy_figures
from freerein.cli.demo.output_folder import MARKER, prepare
from freerein.cli.demo.pipeline import TASKS, TEXTS, pipeline
from freerein.cli.demo.report import Figure, Reporter, summary, write
from freerein.cli.demo.results import Results, noun_phrases
from freerein.cli.demo.run import isolated_environ, run
from freerein.cli.services.endpoints import running_endpoints
from freerein.errors import FailedPrecondition, InvalidInput
from freerein_orchestrator.__main__ import resolve


def test_services_that_run_are_where_the_environment_says_and_else_on_loopback() -> None:
    endpoints = running_endpoints(("sim", "reward"), {"FREEREIN_SIM_ADDRESS": "sim:9999"})
    assert endpoints.addresses == {"sim": "sim:9999", "reward": "127.0.0.1:9103"}
    assert endpoints.urls == {"sim": "http://sim:8104", "reward": "http://127.0.0.1:8103"}


def test_services_of_the_demos_own_share_in_nobodys_runs() -> None:
    asked = {
        "FREEREIN_DATABASE_URL": "postgresql://somebody",
        "FREEREIN_EXECUTOR_ID": "worker-2",
        "FREEREIN_SIM_ADDRESS": "elsewhere:9104",
        "FREEREIN_QUEUE": "7",
    }
    assert isolated_environ(asked) == {"FREEREIN_QUEUE": "7"}


@pytest.mark.parametrize("out", [".", "var", "var/datasets", "var/datasets/new"])
@pytest.mark.parametrize("is_running", [True, False])
async def test_the_demo_does_not_empty_what_holds_the_services_data_or_belongs_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: str, is_running: bool
) -> None:
    kept = tmp_path / "var" / "datasets" / "kept"
    kept.mkdir(parents=True)
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path / "var"))
    with pytest.raises(InvalidInput, match="must not hold the services' data directory"):
        await run(tmp_path / out, seed=0, reporter=Reporter(as_json=True), running=is_running)
    assert kept.exists()


@pytest.mark.parametrize("held", ["thesis.tex", "data/mine.csv", "summary.json"])
async def test_the_demo_empties_no_folder_that_it_did_not_make(tmp_path: Path, held: str) -> None:
    out = tmp_path / "out"
    (out / held).parent.mkdir(parents=True)
    (out / held).touch()
    with pytest.raises(FailedPrecondition, match="must be new, empty, or made by a demo") as error:
        await run(out, seed=0, reporter=Reporter(as_json=True), running=False)
    assert "--out" in error.value.hint
    assert (out / held).exists()


def test_the_output_of_an_earlier_demo_is_deleted_however_far_it_came(tmp_path: Path) -> None:
    for name in (MARKER, "summary.json", "data/logs/sim.log"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    prepare(tmp_path, keep=None)
    assert [path.name for path in tmp_path.iterdir()] == [MARKER]
    (tmp_path / "data" / "begun").mkdir(parents=True)
    prepare(tmp_path, keep=tmp_path.parent)
    assert [path.name for path in tmp_path.iterdir()] == [MARKER]


@pytest.mark.parametrize(
    ("figure", "bar", "met"),
    [
        (Figure("a", 0.6, 0.5, "guess", beats_baseline=True), "above baseline", True),
        (Figure("a", 0.5, 0.5, "guess", beats_baseline=True), "above baseline", False),
        (Figure("a", 9, 0, "guess", (-1, 20), beats_baseline=True), "interval above baseline", False),
        (Figure("a", 9, 0, "guess", (1, 20), beats_baseline=True), "interval above baseline", True),
        (Figure("a", 0.9, at_least=0.99), ">= 0.99", False),
        (Figure("a", 580, at_most=600), "<= 600", True),
        (Figure("a", 0.6, 0.5, "guess"), "", None),
    ],
)
def test_a_bar_is_the_baseline_or_a_number_and_an_interval_must_clear_it(figure: Figure, bar: str, met: bool) -> None:
    assert (figure.bar, figure.met) == (bar, met)


def test_the_summary_is_written_as_json_and_as_a_table(tmp_path: Path) -> None:
    figures = (Figure("x.y", 0.25, 0.5, "a coin", beats_baseline=True), Figure("s", 3.0))
    write(tmp_path, figures, summary(figures, seed=4, shipped={"ppo": ["left"]}))
    found = json.loads((tmp_path / "summary.json").read_text())
    assert (found["x.y"], found["s"], found["seed"], found["shipped"]) == (0.25, 3.0, 4, {"ppo": ["left"]})
    assert found["figures"]["x.y"]["met"] is False
    rows = (tmp_path / "summary.md").read_text().splitlines()
    assert rows[2] == "| x.y | 0.25 |  | 0.5 (a coin) | above baseline | not met |"


def test_the_figures_of_ppo_and_distillation_are_those_of_the_evaluations() -> None:
    def measured(value: float, baseline: float | None = None) -> dict[str, float | None]:
        return {"value": value, "low": value - 1, "high": value + 1, "baseline": baseline}

    told = [
        {"task": task, "goal_text": text, "return_mean": measured(10 * row + column)}
        for row, task in enumerate(TASKS.values())
        for column, text in enumerate(TEXTS.values())
    ]
    sentences = {"own_text_return": measured(6, 5), "word_blind": measured(5), "gain_by_words": measured(0.5, 0)}
    returns = {"return_mean": measured(9, 7), "baseline_return_mean": measured(7), "expert_return_mean": measured(80)}
    documents = {
        "random-left": {"figures": {"return_mean": measured(1)}},
        "random-right": {"figures": {"return_mean": measured(2)}},
        "ppo-returns": {"figures": returns},
        "sentences": {"figures": sentences, "told": told},
    }
    results = Results({f"{step}.result.json": json.dumps(each).encode() for step, each in documents.items()})
    found = {each.name: each for each in policy_figures(results)}
    assert {name: (each.value, each.baseline, each.met) for name, each in found.items()} == {
        "ppo.return_first": (7, 1, None),
        "ppo.return_last": (9, 8, False),
        "ppo.expert_return": (80, None, True),
        "distill.left_of.told_left": (0, 1, None),
        "distill.left_of.told_right": (1, 1, None),
        "distill.right_of.told_left": (10, 2, None),
        "distill.right_of.told_right": (11, 2, None),
        "distill.own_sentence_return": (6, 5, None),
        "distill.word_blind": (5, None, True),
        "distill.gain_by_words": (0.5, 0, False),
    }
    assert found["ppo.return_last"].interval == (8, 10)


def test_the_pipeline_is_one_that_the_orchestrator_takes(tmp_path: Path) -> None:
    resolved = resolve("pipeline", pipeline(3), tmp_path)
    assert [step["name"] for step in resolved.config["steps"]] == [step["name"] for step in pipeline(3)["steps"]]


def test_the_noun_phrases_of_a_pair_are_what_its_captions_share() -> None:
    captions = [f"a red block {words} a blue block" for words in ("to the left of", "on top of", "below")]
    assert noun_phrases(captions) == ("a red block", "a blue block")
