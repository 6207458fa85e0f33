"""The list of experiments and arms, and runs that train nothing, over results as they lie on disk."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from experiments import registry
from experiments.__main__ import main
from experiments.smoke import EXPERIMENT as SMOKE
from experiments.workbench import results
from experiments.workbench.arms import Arm, world_version
from experiments.workbench.configs import to_json
from experiments.workbench.results import ArmResult, Sample

ARM = SMOKE.arms[0]


def result(arm: Arm, *, minutes: float) -> ArmResult:
    """Returns a current result of an arm of `smoke`."""
    made_by, sample = to_json(SMOKE.config(arm)), {"test": Sample([1.0], [1.0])}
    return ArmResult(
        arm.name, arm.world, arm.method, arm.options, arm.seed, made_by, world_version(arm.world), {}, sample,
        minutes, minutes, {}, "",
    )  # fmt: skip


def test_experiments_are_listed_with_arms_results_minutes_and_status(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results.save(result(ARM, minutes=12.5), tmp_path / "smoke")
    outdated = SMOKE.arms[1]
    results.save(replace(result(outdated, minutes=3.0), world_version="grid-v0"), tmp_path / "smoke")

    assert main(["list", "--results", str(tmp_path)]) == 0
    header, *rows = capsys.readouterr().out.splitlines()
    assert header.split() == ["experiment", "arms", "results", "minutes", "status"]
    assert [row.split()[0] for row in rows] == list(registry.EXPERIMENTS)
    assert rows[-1].split() == ["smoke", "7", "1", "12", "1", "outdated,", "5", "missing"]

    assert main(["list", "smoke", "--results", str(tmp_path)]) == 0
    arms = capsys.readouterr().out.splitlines()
    assert arms[0].split() == [ARM.name, "present", "12.5", "minutes"]
    assert arms[1].split() == [outdated.name, "outdated", "3.0", "minutes"]
    assert arms[2].split()[1:] == ["missing", "unknown", "minutes"]


def test_a_packed_result_is_shown_with_its_configuration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results.save(result(ARM, minutes=1.0), tmp_path / "smoke")
    assert main(["pack", "smoke", "--results", str(tmp_path)]) == 0

    assert main(["show", "smoke", ARM.name, "--results", str(tmp_path)]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["name"], shown["config"]) == (ARM.name, to_json(SMOKE.config(ARM)))
    assert main(["show", "smoke", SMOKE.arms[1].name, "--results", str(tmp_path)]) == 2
    assert f"--only '{SMOKE.arms[1].name}'" in capsys.readouterr().err


def test_a_dry_run_names_what_would_run_and_how_long_other_seeds_took_and_trains_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places, saved = ["--results", str(tmp_path / "results"), "--work", str(tmp_path / "work")], tmp_path / "results"
    other = replace(ARM, seed=9)
    results.save(replace(result(ARM, minutes=4.0), name=other.name, seed=9), saved / "smoke")

    assert main(["run", "smoke", "--dry-run", "--only", ARM.name, *places]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"{ARM.name}  missing       4.0 minutes",
        "1 of 1 arms would run; 1 of them took 4 minutes before, or other seeds did.",
    ]
    assert main(["run", "smoke", "--dry-run", "--only", "no-such-arm", *places]) == 2
    assert not (tmp_path / "work").exists()
    assert [path.name for path in saved.rglob("*.json")] == [f"{other.name}.json"]
