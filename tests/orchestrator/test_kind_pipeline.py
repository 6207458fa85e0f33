"""Runs of kind `pipeline`, with the real sim and imitation services."""

import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from freerein.clients import Channel, FitClient, SyncClient
from freerein.data import Dataset, dataset_path
from freerein.errors import InvalidInput, NotFound, OutOfStorage, ServiceError
from freerein.types.learning import Fit, ListFitsRequest
from freerein_orchestrator.kinds import KINDS

pytestmark = pytest.mark.e2e
TINY = {"steps": 6, "batch_size": 2, "features": 8, "hidden_size": 8, "embedding_size": 4, "log_every": 2}
COLLECT = {
    "name": "play",
    "kind": "collect",
    "config": {"task": "grid", "dataset": "play", "behaviour": "random", "count": 3},
}
FIT = {"name": "fit", "kind": "fit", "config": {"service": "imitation", "dataset": "play", "config": TINY}}
CHANCE = {"name": "chance", "kind": "evaluate", "config": {"task": "grid", "policy": "random", "episodes": 2}}
LACKING = {"task": "grid", "policy": "random", "form": "landmarks"}
"""An evaluation that needs predicates that the task lacks."""
FITTED = {"name": "fitted", "kind": "evaluate", "config": {"task": "grid", "policy": {"run": "fit"}}}


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any]) -> str:
    return str(start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1").address)


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def addresses(start_module_service: Callable[..., Any], sim: str, data_dir: Path) -> dict[str, str]:
    """Where sim and imitation are, by variable."""
    imitation = start_module_service("freerein_imitation", data_dir, FREEREIN_SHIPPED_DIR="none")
    return {"FREEREIN_SIM_ADDRESS": sim, "FREEREIN_IMITATION_ADDRESS": imitation.address}


@pytest.fixture
def fits(addresses: dict[str, str]) -> Iterator[Callable[[], list[Fit]]]:
    """A function that returns the fits of this test, newest first."""
    with SyncClient(FitClient(Channel(addresses["FREEREIN_IMITATION_ADDRESS"]))) as client:
        before = len(client.list_fits(ListFitsRequest()).fits)
        yield lambda: list(client.list_fits(ListFitsRequest()).fits[: -before or None])


@pytest.mark.fault("O1")
def test_a_pipeline_killed_between_its_steps_does_each_once_and_shows_all_in_one_curve(
    new_run: Callable[..., Any], addresses: dict[str, str], data_dir: Path, fits: Callable[[], list[Fit]]
) -> None:
    pipeline = new_run(data_dir, "pipeline", {"steps": [COLLECT, CHANCE, FIT | {"after": ["play"]}]}, **addresses)
    done = pipeline.folder / "parts" / "play" / "done.json"
    pipeline.kill_when(done.exists)
    recorded, fingerprint = done.stat().st_mtime_ns, Dataset(dataset_path(data_dir, "play")).fingerprint

    assert pipeline.do()

    assert (done.stat().st_mtime_ns, Dataset(dataset_path(data_dir, "play")).fingerprint) == (recorded, fingerprint)
    assert len(fits()) == 1
    steps = [row["step"] for row in pipeline.rows]
    assert (steps == sorted(set(steps)), steps[-1], pipeline.kind.steps(pipeline.config)) == (True, 11, 11)
    assert {name.partition("/")[0] for row in pipeline.rows for name in row} == {"step", "play", "fit", "chance"}
    assert pipeline.artifact("play.dataset.json")["fingerprint"] == fingerprint
    (mean,) = [row["chance/return_mean"] for row in pipeline.rows if "chance/return_mean" in row]
    assert pipeline.artifact("chance.result.json")["figures"]["return_mean"]["value"] == mean
    assert pipeline.model.name == "default"
    rows = [(row["name"], row["kind"], row["steps"]) for row in pipeline.artifact("steps.json")]
    assert rows == [("play", "collect", 3), ("chance", "evaluate", 2), ("fit", "fit", 6)]


def test_a_fit_begins_beside_the_steps_that_it_does_not_come_after_and_is_cancelled_when_the_run_is_or_fails(
    new_run: Callable[..., Any],
    addresses: dict[str, str],
    data_dir: Path,
    fits: Callable[[], list[Fit]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("freerein_orchestrator.kinds.fit._CANCEL_S", 60.0)

    def collect(name: str) -> dict[str, Any]:
        return COLLECT | {"config": COLLECT["config"] | {"dataset": name}}

    def long(name: str) -> dict[str, Any]:
        return FIT | {
            "config": FIT["config"] | {"dataset": name, "config": TINY | {"steps": 100_000}},
            "after": ["play"],
        }

    many = CHANCE | {"config": CHANCE["config"] | {"episodes": 100_000}}
    lost = CHANCE | {"name": "lost", "config": LACKING}
    run = new_run(data_dir, "pipeline", {"steps": [collect("walk"), many, long("walk")]}, **addresses)
    assert not run.do(stop=lambda: any(fit.state == "running" for fit in fits()))
    assert [each.parent.name for each in run.folder.glob("parts/*/done.json")] == ["play"]
    assert not run.do(stop=lambda: True, cancelled=True)
    (fit,) = fits()
    assert fit.state == "cancelled"
    with pytest.raises(InvalidInput):
        new_run(data_dir, "pipeline", {"steps": [collect("again"), lost, long("again")]}, **addresses).do()
    begun, _ = fits()
    assert (begun.id != fit.id, begun.state) == (True, "cancelled")


def test_fits_are_cancelled_at_once_though_their_service_does_not_answer(
    new_run: Callable[..., Any], tmp_path: Path
) -> None:
    names = [f"fit-{number}" for number in range(8)]
    with socket.create_server(("127.0.0.1", 0)) as silent:
        nowhere = f"127.0.0.1:{silent.getsockname()[1]}"
        steps = [COLLECT, *(FIT | {"name": name, "after": ["play"]} for name in names)]
        addresses = {"FREEREIN_SIM_ADDRESS": nowhere, "FREEREIN_IMITATION_ADDRESS": nowhere}
        run = new_run(tmp_path, "pipeline", {"steps": steps}, **addresses)
        for name in names:
            begun = run.folder / "parts" / name / "fit.json"
            begun.parent.mkdir(parents=True)
            begun.write_text(json.dumps({"id": "a" * 32}))
        started_s = time.monotonic()
        assert not run.do(stop=lambda: True, cancelled=True)
        assert time.monotonic() - started_s < 20  # and no deadline of a call, 30 s


def test_the_seconds_of_a_step_are_those_of_all_its_attempts(
    new_run: Callable[..., Any], sim: str, tmp_path: Path
) -> None:
    run = new_run(tmp_path, "pipeline", {"steps": [CHANCE]}, FREEREIN_SIM_ADDRESS=sim)
    spent = run.folder / "parts" / "chance" / "seconds"
    assert not run.do(stop=spent.parent.is_dir)
    spent.write_text("1000.0")
    assert run.do()
    (row,) = run.artifact("steps.json")
    assert 1000 < row["seconds"] < 1100


@pytest.mark.parametrize("steps", [[COLLECT, CHANCE | {"after": ["play"]}], [FIT | {"after": ["play"]}, COLLECT]])
def test_only_a_fit_may_begin_early_and_only_after_earlier_steps(steps: Any) -> None:
    with pytest.raises(InvalidInput, match=r"earlier steps|before their turn") as error:
        KINDS["pipeline"].parse({"steps": steps})
    assert error.value.field == "config.steps.after"


def test_a_step_that_builds_on_an_earlier_one_is_taken_and_one_that_builds_on_a_later_one_is_refused(
    new_run: Callable[..., Any], tmp_path: Path
) -> None:
    new_run(tmp_path, "pipeline", {"steps": [COLLECT, FIT, FITTED]}).check()
    pupil = {"name": "pupil", "kind": "ppo", "config": {"task": "grid", "init_from": "teacher"}}
    for steps in ([COLLECT, FITTED, FIT], [FITTED], [pupil, pupil | {"name": "teacher"}]):
        run = new_run(tmp_path, "pipeline", {"steps": steps})
        with pytest.raises(InvalidInput, match=r"In step (fitted|pupil): .* earlier step") as error:
            run.check()
        assert error.value.field.startswith("config.steps")
    reward = FIT | {"config": {"service": "reward", "dataset": "play", "config": {"method": "relation_captions"}}}
    with pytest.raises(InvalidInput, match="fit is of the kind fit of reward"):
        new_run(tmp_path, "pipeline", {"steps": [COLLECT, reward, FITTED]}).check()


@pytest.mark.parametrize(
    "steps",
    [
        [],
        [FIT, FIT],
        [FIT | {"kind": "dream"}],
        [FIT | {"kind": "pipeline", "config": {"steps": []}}],
        [FIT | {"name": "x" * 25}],
        [FIT | {"config": {"service": "sim", "dataset": "play"}}],
        [FIT | {"needs": "play"}],
        ["fit"],
    ],
)
def test_what_is_no_pipeline_is_refused(steps: Any) -> None:
    with pytest.raises(InvalidInput) as error:
        KINDS["pipeline"].parse({"steps": steps})
    assert error.value.field.startswith("config")


def test_a_step_that_fails_says_which_one_it_is(new_run: Callable[..., Any], sim: str, tmp_path: Path) -> None:
    run = new_run(
        tmp_path,
        "pipeline",
        {"steps": [CHANCE, CHANCE | {"name": "lost", "config": LACKING}]},
        FREEREIN_SIM_ADDRESS=sim,
    )
    with pytest.raises(InvalidInput, match="In step lost: "):
        run.do()
    assert (run.folder / "parts" / "chance" / "done.json").exists()


@pytest.mark.parametrize(
    ("change", "error"), [({"task": "nothing"}, NotFound), ({"conditions": ["blur", "fog"]}, InvalidInput)]
)
def test_a_task_of_a_later_step_or_a_condition_that_there_is_none_of_is_refused_before_the_first_step(
    new_run: Callable[..., Any], sim: str, tmp_path: Path, change: dict[str, Any], error: type[ServiceError]
) -> None:
    lost = CHANCE | {"name": "lost", "config": CHANCE["config"] | change}
    run = new_run(tmp_path, "pipeline", {"steps": [CHANCE, lost]}, FREEREIN_SIM_ADDRESS=sim)
    with pytest.raises(error, match=r"In step lost: .* got `(nothing|fog)`") as refused:
        run.do()
    assert refused.value.field.startswith("config.steps.config.")
    assert not run.rows


@pytest.mark.fault("O5")
def test_a_step_that_cannot_be_finished_on_a_full_disk_says_which_one_it_is_and_is_finished_later(
    new_run: Callable[..., Any], sim: str, tmp_path: Path
) -> None:
    run = new_run(tmp_path, "pipeline", {"steps": [CHANCE]}, FREEREIN_SIM_ADDRESS=sim)
    done = run.folder / "parts" / "chance" / "done.json"
    done.parent.mkdir(parents=True)
    done.with_name("done.json.tmp").symlink_to("/dev/full")
    with pytest.raises(OutOfStorage, match=r"In step chance: .* No space left"):
        run.do()
    assert not done.exists()
    assert run.do()
