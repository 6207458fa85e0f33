"""Tiny arms from demonstrations to a table, through the commands; one of them is stopped, and then killed."""

import fcntl
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from experiments import registry
from experiments.__main__ import main
from experiments.smoke import EXPERIMENT as SMOKE
from experiments.workbench import results
from experiments.workbench.arms import choose, world_version
from experiments.workbench.configs import to_json
from experiments.workbench.results import ArmResult, Sample
from experiments.workbench.runner import Ending, Places, arm_folder, run_arms

from freerein_segmentation.methods import METHODS

ROOT = Path(__file__).parents[2]
ARM = "grid-lse-causal-seed0"
ARMS = (ARM, "grid-supervised-causal-seed0", "grid-random_cls-seed0")
FIELDS = (
    "claim value low high seeds trials scale baseline ceiling gap_closed dissertation target met world_version command "
    "minutes"
)


@pytest.fixture(autouse=True)
def _in_the_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def options(places: Places) -> list[str]:
    return ["--results", str(places.results), "--work", str(places.work)]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Places:
    """Places in which the arms ran without interruption."""
    root = tmp_path_factory.mktemp("uninterrupted")
    places = Places(root / "results", root / "work")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        assert main(["run", "smoke", "--jobs", "2", "--only", *ARMS, *options(places)]) == 0
    return places


@pytest.mark.long
def test_an_arm_that_was_stopped_and_then_killed_goes_on_to_the_same_result(
    tmp_path: Path, uninterrupted: Places
) -> None:
    for attempt in range(5):  # where this process stands still for seconds, the arm is stopped too late to be killed
        places = Places(tmp_path / f"results{attempt}", tmp_path / f"work{attempt}")
        folder = smoke_folder(places)
        children_with_lock: set[str] = set()
        ending = run_smoke(places, should_stop=partial(has_checkpoint, folder, children_with_lock))
        if newest_checkpoint(folder) < "step-000000014":
            break
    assert ending == ["stopped"]
    assert len(children_with_lock) == 1
    stopped = assert_unfinished(folder)
    assert json.loads((folder / "elapsed.json").read_bytes())["cpu_s"] > 0

    script = [sys.executable, str(Path(__file__).with_name("killed_arm.py")), str(folder), str(places.work), ARM]
    ended = subprocess.run(script, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False)
    assert ended.returncode == -signal.SIGKILL
    assert assert_unfinished(folder) > stopped

    assert main(["run", "smoke", "--only", ARM, *options(places)]) == 0

    assert_same_result(places, uninterrupted)


def test_an_arm_leaves_a_model_that_the_service_loads(uninterrupted: Places) -> None:
    model = METHODS.load(smoke_folder(uninterrupted) / "model", "cpu")
    assert model.skills == SMOKE.studies[0].data.world.skills


def test_an_arm_waits_for_the_lock_of_its_folder(tmp_path: Path) -> None:
    places = Places(tmp_path / "results", tmp_path / "work")
    folder = smoke_folder(places)
    folder.mkdir(parents=True)
    polls = iter([False, False, True])
    with (folder / "lock").open("wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert run_smoke(places, should_stop=lambda: next(polls)) == ["stopped"]
    assert [path.name for path in folder.iterdir()] == ["lock"]


@pytest.mark.long
def test_arms_become_results_and_these_a_table_with_claims(
    uninterrupted: Places, capfd: pytest.CaptureFixture[str]
) -> None:
    places = uninterrupted

    assert main(["run", "smoke", "--only", *ARMS, *options(places)]) == 0
    assert capfd.readouterr().out.count("present") == 3
    assert main(["table", "smoke", "--results", str(places.results)]) == 0

    folder = places.results / "smoke"
    claims = json.loads((folder / "table.json").read_bytes())["claims"]
    assert [claim["claim"].removeprefix("smoke.") for claim in claims if claim["claim"].endswith("test")] == [
        "grid.random_cls.test",
        "grid.lse.causal.test",
        "grid.supervised.causal.test",
    ]
    assert all(list(claim) == FIELDS.split() for claim in claims)
    assert all(claim["low"] <= claim["value"] <= claim["high"] for claim in claims)
    assert {claim["seeds"] for claim in claims if "random_cls" in claim["claim"]} == {None}
    assert {claim["scale"] for claim in claims} == {None}
    by_name = {claim["claim"]: claim for claim in claims}
    assert by_name["smoke.grid.lse.causal.test"]["ceiling"] == by_name["smoke.grid.supervised.causal.test"]["value"]
    assert "| lse | causal |" in (folder / "table.md").read_text()
    assert (folder / "table.png").read_bytes().startswith(b"\x89PNG")


def test_no_time_left_stops_an_arm_and_a_later_run_would_resume_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = Places(tmp_path / "results", tmp_path / "work")
    assert main(["run", "smoke", "--minutes", "0", "--only", ARM, *options(places)]) == 1
    assert "stopped" in capsys.readouterr().out
    assert not places.results.exists()


EVALUATED_FIGURES = (
    "lr",
    "action_loss",
    *(f"test.{name}" for name in ("balanced_accuracy", "edit_score", "f1_at_50", "decoded_accuracy")),
    "test.decoded_edit_score",
)


@pytest.fixture
def current() -> ArmResult:
    """A result that the smoke experiment would not replace."""
    (arm,) = choose(SMOKE, [ARM])
    return ArmResult(
        name=ARM,
        world=arm.world,
        method=arm.method,
        options=arm.options,
        seed=arm.seed,
        config=to_json(SMOKE.config(arm)),
        world_version=world_version(arm.world),
        figures=dict.fromkeys(EVALUATED_FIGURES, 0.5),
        samples={f"{split}.frame_accuracy": Sample([1, 2], [3, 3]) for split in ("train", "validation", "test")},
        minutes=1.5,
        cpu_minutes=1.25,
        machine={},
        command="",
    )


def without_key_with_default(result: ArmResult) -> ArmResult:
    """Returns a result as it would have been saved before a key was added to the segmentation service's fits."""
    config = to_json(result.config)
    del config["fit"]["rounds"]
    return replace(result, config=config)


CHANGES = pytest.mark.parametrize("change", [{"config": {"data": {}}}, {"world_version": "grid-v0"}])


@CHANGES
def test_an_arm_runs_again_when_another_configuration_or_world_made_its_result(
    change: dict[str, Any], current: ArmResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = Places(tmp_path / "results", tmp_path / "work")
    run = ["run", "smoke", "--minutes", "0", "--only", ARM, *options(places)]

    results.save(without_key_with_default(current), places.results / "smoke")
    assert main(run) == 0
    assert capsys.readouterr().out == f"{ARM}: present\n"

    results.save(replace(current, **change), places.results / "smoke")
    assert main(run) == 1
    assert capsys.readouterr().out == f"{ARM}: stopped\n"


@CHANGES
def test_a_table_leaves_out_what_another_configuration_or_world_made(
    change: dict[str, Any], current: ArmResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = next(arm for arm in SMOKE.arms if arm.name == "grid-lse-causal-seed1")
    stale = replace(replace(current, name=other.name, seed=1, config=to_json(SMOKE.config(other))), **change)
    results.save(stale, tmp_path / "smoke")
    assert main(["table", "smoke", "--results", str(tmp_path)]) == 2
    assert "python -m experiments run" in capsys.readouterr().err

    results.save(without_key_with_default(current), tmp_path / "smoke")
    assert main(["table", "smoke", "--results", str(tmp_path)]) == 0
    assert capsys.readouterr().err == f"{other.name} is left out: another configuration or another world made it.\n"
    claims = json.loads((tmp_path / "smoke" / "table.json").read_bytes())["claims"]
    assert {(claim["claim"], claim["seeds"]) for claim in claims} == {
        (f"smoke.grid.lse.causal.{split}", 1) for split in ("train", "validation", "test")
    }


def test_an_unknown_arm_and_missing_results_are_refused_with_a_hint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "smoke", "--only", "grid-lse-sideways-*"]) == 2
    assert main(["table", "smoke", "--results", str(tmp_path)]) == 2
    assert main(["table", "atlantis"]) == 2
    assert "python -m experiments run" in capsys.readouterr().err


@pytest.mark.parametrize(
    "name", [name for name in registry.EXPERIMENTS if (ROOT / "experiments/results" / name).exists()]
)
def test_a_committed_table_follows_from_the_committed_results(name: str, tmp_path: Path) -> None:
    committed = ROOT / "experiments/results"
    for path in committed.glob("*/*.json"):
        (tmp_path / path.parent.name).mkdir(exist_ok=True)
        (tmp_path / path.relative_to(committed)).write_bytes(path.read_bytes())

    assert main(["table", name, "--results", str(tmp_path)]) == 0

    for file in ("table.md", "table.json"):
        made, kept = (folder / name / file for folder in (tmp_path, committed))
        assert made.read_text() == kept.read_text(), "stale: run make tables"


def smoke_folder(places: Places) -> Path:
    (arm,) = choose(SMOKE, [ARM])
    return arm_folder("smoke", SMOKE, arm, places)


def run_smoke(places: Places, *, should_stop: Callable[[], bool]) -> list[Ending]:
    arms = choose(SMOKE, [ARM])
    return run_arms("smoke", SMOKE, arms, places=places, jobs=1, should_stop=should_stop, on_end=lambda *_: None)


def children_with(path: Path) -> set[str]:
    """Returns the ids of this process's children that have a file open."""
    children = [child for each in Path("/proc/self/task").glob("*/children") for child in each.read_text().split()]
    opened = {child: Path("/proc", child, "fd").glob("*") for child in children}
    return {child for child, files in opened.items() if any(os.path.realpath(each) == str(path) for each in files)}


def has_checkpoint(folder: Path, children_with_lock: set[str]) -> bool:
    """Returns whether an arm has saved one; adds the children that have its lock."""
    children_with_lock.update(children_with(folder / "lock"))
    return any(folder.glob("checkpoints/*/*"))


def newest_checkpoint(folder: Path) -> str:
    return max(path.name for path in (folder / "checkpoints").iterdir())


def assert_unfinished(folder: Path) -> str:
    """Returns the name of the newest checkpoint, which is not the last."""
    newest = newest_checkpoint(folder)
    assert "24" not in newest
    return newest


def assert_same_result(places: Places, expected: Places) -> None:
    ours, theirs = (results.load(each.results / "smoke" / f"{ARM}.json") for each in (places, expected))
    assert ours.figures == theirs.figures
    assert ours.samples == theirs.samples
    assert last_checkpoint(smoke_folder(places)) == last_checkpoint(smoke_folder(expected))


def last_checkpoint(folder: Path) -> dict[str, bytes]:
    newest = max((folder / "checkpoints").iterdir())
    return {path.name: path.read_bytes() for path in newest.iterdir()}
