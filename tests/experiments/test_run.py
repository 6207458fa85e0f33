"""Tiny arms, through the commands; one of them is killed, and then stopped. Results become tables."""

import fcntl
import itertools
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from experiments import registry
from experiments.__main__ import main, make_table
from experiments.segmentation.dataset import SPLITS
from experiments.smoke import EXPERIMENT as SMOKE
from experiments.workbench import results, table
from experiments.workbench.arms import choose, world_version
from experiments.workbench.configs import to_json
from experiments.workbench.results import ArmResult, Outcome, Sample
from experiments.workbench.runner import Ending, Places, arm_folder, run_arms

from freerein_segmentation.methods import METHODS

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "experiments" / "results"
ARM = "grid-lse-causal-seed0"
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
def places(tmp_path_factory: pytest.TempPathFactory) -> Places:
    root = tmp_path_factory.mktemp("smoke")
    return Places(root / "results", root / "work")


@pytest.fixture(scope="module")
def uninterrupted(places: Places) -> Outcome:
    """The outcome of an arm that ran without interruption, in the folder `uninterrupted` beside its own."""
    outcome = run_here(places, smoke_folder(places).with_name("uninterrupted"))
    assert outcome is not None
    return outcome


@pytest.mark.long
def test_an_arm_that_was_killed_and_then_stopped_goes_on_to_the_same_result(
    places: Places, uninterrupted: Outcome
) -> None:
    folder = smoke_folder(places)
    script = [sys.executable, str(Path(__file__).with_name("killed_arm.py")), str(folder), str(places.work), ARM]
    ended = subprocess.run(script, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False)
    assert ended.returncode == -signal.SIGKILL
    killed = newest_checkpoint(folder).name

    events = itertools.count(1)

    def stop_at_second_event() -> None:
        if next(events) == 2:
            os.kill(os.getpid(), signal.SIGTERM)

    assert run_here(places, folder, on_progress=stop_at_second_event) is None
    assert killed < newest_checkpoint(folder).name < newest_checkpoint(folder.with_name("uninterrupted")).name

    assert main(["run", "smoke", "--only", ARM, *options(places)]) == 0

    result = results.load(places.results / "smoke" / f"{ARM}.json")
    assert (result.figures, result.samples) == (uninterrupted.figures, uninterrupted.samples)
    assert result.cpu_minutes > 0
    assert contents(newest_checkpoint(folder)) == contents(newest_checkpoint(folder.with_name("uninterrupted")))


def test_an_arm_leaves_a_model_that_the_service_loads(places: Places, uninterrupted: Outcome) -> None:
    model = METHODS.load(smoke_folder(places).with_name("uninterrupted") / "model", "cpu")
    assert model.skills == SMOKE.studies[0].data.world.skills


@pytest.mark.parametrize("name", ["grid-supervised-causal-seed0", "grid-random_cls-seed0"])
def test_the_ceiling_and_guesses_are_evaluated_alike(name: str, places: Places, uninterrupted: Outcome) -> None:
    outcome = run_here(places, places.work / name, name=name)
    assert outcome is not None
    assert outcome.figures.keys() <= uninterrupted.figures.keys()
    assert outcome.samples.keys() <= uninterrupted.samples.keys()
    assert {f"{split}.frame_accuracy" for split in SPLITS} <= outcome.samples.keys()


def test_an_arm_waits_for_the_lock_of_its_folder(tmp_path: Path) -> None:
    places = Places(tmp_path / "results", tmp_path / "work")
    folder = smoke_folder(places)
    folder.mkdir(parents=True)
    polls = iter([False, False, True])
    with (folder / "lock").open("wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert run_smoke(places, should_stop=lambda: next(polls)) == ["stopped"]
    assert [path.name for path in folder.iterdir()] == ["lock"]


def test_the_child_process_of_an_arm_has_its_lock_and_is_stopped_when_time_is_up(tmp_path: Path) -> None:
    places = Places(tmp_path / "results", tmp_path / "work")
    lock, children_with_lock = smoke_folder(places) / "lock", set[str]()

    def is_started() -> bool:
        children_with_lock.update(children_with(lock))
        return bool(children_with_lock)

    assert run_smoke(places, should_stop=is_started) == ["stopped"]
    assert len(children_with_lock) == 1
    assert not places.results.exists()


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


def test_results_become_a_table_with_claims(current: ArmResult, tmp_path: Path) -> None:
    better = {name: Sample([2, 3], [3, 3]) for name in current.samples}
    for arm in choose(SMOKE, ["*-seed0"]):
        config, samples = to_json(SMOKE.config(arm)), better if arm.method == "supervised" else current.samples
        named = {"name": arm.name, "method": arm.method, "options": arm.options}
        results.save(replace(current, **named, config=config, samples=samples), tmp_path / "smoke")

    assert main(["table", "smoke", "--results", str(tmp_path)]) == 0

    claims = json.loads((tmp_path / "smoke" / "table.json").read_bytes())["claims"]
    assert [claim["claim"].removeprefix("smoke.") for claim in claims if claim["claim"].endswith("test")] == [
        "grid.random.test",
        "grid.random_cls.test",
        "grid.majority.test",
        "grid.lse.causal.test",
        "grid.supervised.causal.test",
    ]
    assert all(list(claim) == FIELDS.split() for claim in claims)
    assert all(claim["low"] <= claim["value"] <= claim["high"] for claim in claims)
    assert {claim["seeds"] for claim in claims if "random_cls" in claim["claim"]} == {None}
    assert {claim["scale"] for claim in claims} == {None}
    by_name = {claim["claim"]: claim for claim in claims}
    assert by_name["smoke.grid.lse.causal.test"]["ceiling"] == by_name["smoke.grid.supervised.causal.test"]["value"]
    assert "| lse | causal |" in (tmp_path / "smoke" / "table.md").read_text()
    assert (tmp_path / "smoke" / "table.png").read_bytes().startswith(b"\x89PNG")


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


def test_every_arm_has_a_name_and_a_configuration_of_its_own() -> None:
    for name in registry.EXPERIMENTS:
        experiment = registry.load(name)
        configs = {arm.name: experiment.config(arm) for arm in experiment.arms}
        assert len(configs) == len(experiment.arms), name


@pytest.mark.parametrize("name", [name for name in registry.EXPERIMENTS if (RESULTS / name / "table.md").exists()])
def test_a_committed_table_follows_from_the_committed_results(name: str) -> None:
    made = make_table(name, RESULTS)
    assert made is not None
    assert table.markdown(made) == (RESULTS / name / "table.md").read_text(), "stale: run make tables"
    assert table.claims_json(made) == (RESULTS / name / "table.json").read_text(), "stale: run make tables"


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


def run_here(
    places: Places, folder: Path, *, name: str = ARM, on_progress: Callable[[], None] = lambda: None
) -> Outcome | None:
    """Runs an arm in this process, in a folder."""
    (arm,) = choose(SMOKE, [name])
    return SMOKE.run(arm, results=places.results, work=places.work, folder=folder, on_progress=on_progress)


def newest_checkpoint(folder: Path) -> Path:
    return max(folder.glob("lr-*/checkpoints/*"))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}
