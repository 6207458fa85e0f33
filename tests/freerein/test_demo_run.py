"""The demo's output folder, its services, and its lines at 80 columns."""

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from freerein.cli.demo.evaluations import Measured, noun_phrases
from freerein.cli.demo.first_results import draw_similarities
from freerein.cli.demo.output_folder import MARKER, prepare
from freerein.cli.demo.pictures import RewardExample
from freerein.cli.demo.report import LOG_WIDTH, Figure, Reporter, summary, write
from freerein.cli.demo.run import run
from freerein.cli.demo.run_progress import RunProgress
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.stack import isolated_environ
from freerein.stack.endpoints import running_endpoints
from freerein.types.orchestrator import Run

RUN = Run(id="1" * 32, state="running", config={}, kind="ppo", steps=1000)
STEPS = Figure.of("timesteps as told, after PPO", Measured(100.0, 82.5, 100.0, 13.1), "steps", "random actions")
SHARE = Figure.of("timesteps right, learned from tags", Measured(1.0, 1.0, 1.0, 0.31), "%", "longest skill")


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
        await run(tmp_path / out, seed=0, reporter=Reporter(is_quiet=True), running=is_running)
    assert kept.exists()


@pytest.mark.parametrize("held", ["thesis.tex", "data/mine.csv", "summary.json"])
async def test_the_demo_empties_no_folder_that_it_did_not_make(tmp_path: Path, held: str) -> None:
    out = tmp_path / "out"
    (out / held).parent.mkdir(parents=True)
    (out / held).touch()
    with pytest.raises(FailedPrecondition, match="must be new, empty, or made by a demo") as error:
        await run(out, seed=0, reporter=Reporter(is_quiet=True), running=False)
    assert "--out" in error.value.hint
    assert (out / held).exists()


def test_the_output_of_an_earlier_demo_is_deleted_however_far_it_came(tmp_path: Path) -> None:
    for name in (MARKER, "summary.json", "data/logs/sim.log"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    prepare(tmp_path, keep=tmp_path.parent)
    assert [path.name for path in tmp_path.iterdir()] == [MARKER]


def test_the_summary_is_written_as_json_and_as_a_table(tmp_path: Path) -> None:
    write(tmp_path, [STEPS, SHARE], summary([STEPS, SHARE], seed=4, seconds={"ppo": 81.26}))
    found = json.loads((tmp_path / "summary.json").read_text())
    assert (found["seed"], found["seconds"]) == (4, {"ppo": 81.3})
    assert found["figures"][SHARE.name]["value"] == 1.0
    rows = (tmp_path / "summary.md").read_text().splitlines()
    assert rows[2:] == [
        "| timesteps as told, after PPO | 100.0 | 82.5 to 100.0 | random actions 13.1 |",
        "| timesteps right, learned from tags | 100 % | 100 to 100 | longest skill 31 % |",
    ]


async def test_a_log_has_whole_lines_of_80_columns(capsys: pytest.CaptureFixture[str]) -> None:
    reporter = Reporter(is_quiet=False)
    reporter.figures([STEPS, SHARE])
    reporter.command("freerein sim demonstrate dial --out demo-dial-0 --count 1 --min-skills 5 --max-skills 5 --truth")
    async with reporter.following(progress_of_ppo()):
        pass
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= LOG_WIDTH
    assert lines[0] == "  timesteps as told, after PPO       100.0 (82.5 to 100.0); random actions 13.1"
    assert lines[1] == "  timesteps right, learned from tags 100 % (100 to 100); longest skill 31 %"
    assert lines[2].endswith(" \\")
    assert lines[4].startswith("  ppo: 40 of 1000, ")
    assert lines[4].endswith(", return -1.23e+03")


def test_a_line_of_progress_says_what_runs_for_how_long_and_how_long_it_still_takes() -> None:
    waiting = RunProgress("ppo", about_s=90, started_s=100)
    assert waiting.line(at_s=103) == "ppo: starting, 3 s, about 87 s left"
    waiting.add(replace(RUN, step=0), at_s=104)
    assert waiting.line(at_s=200) == "ppo: 0 of 1000, 100 s, slower than on two idle cores"
    assert progress_of_ppo().line(at_s=44) == "ppo: 40 of 1000, 44 s, about 960 s left, return -1.23e+03"


def test_progress_on_a_terminal_fits_into_80_columns() -> None:
    console = Console(file=io.StringIO(), width=80)
    console.print(progress_of_ppo().render(at_s=44))
    first, *curve = console.file.getvalue().splitlines()  # type: ignore[attr-defined]  # a StringIO
    assert first.split()[0] == "ppo"
    assert "40 of 1000" in first
    assert first.rstrip().endswith("about 960 s left")
    assert len(curve) == 3


def progress_of_ppo() -> RunProgress:
    """Returns the progress of a run with a step per second."""
    progress = RunProgress("ppo", about_s=90, started_s=0, curve="episode_return", unit="return")
    for step in range(41):
        progress.add(replace(RUN, step=step, metrics={"episode_return": -30.75 * step}), at_s=step)
    return progress


def test_each_sentence_has_a_line_and_the_true_one_is_named() -> None:
    texts = [f"a yellow block {where} a green block" for where in ("to the right of", "below")]
    image = np.zeros((8, 8, 3), np.uint8)
    drawn = draw_similarities(RewardExample(image, (), (), (), texts, np.array([-0.5, 0.25], np.float32), truth=1))
    first, second = drawn.plain.splitlines()
    assert max(len(first), len(second)) <= LOG_WIDTH
    assert (first.split()[-2:], second.split()[-1]) == (["-0.50", "█"], "true")


def test_the_noun_phrases_of_a_pair_are_what_its_captions_share() -> None:
    captions = [f"a red block {words} a blue block" for words in ("to the left of", "on top of", "below")]
    assert noun_phrases(captions) == ("a red block", "a blue block")
