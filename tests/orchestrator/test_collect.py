"""Runs that collect, as child processes and in this one, from the real sim service."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from freerein.clients import Channel, SimClient, SyncClient
from freerein.clients.dataset_recorder import DatasetRecorder
from freerein.data import Dataset, dataset_path
from freerein.errors import FailedPrecondition, InvalidInput, NotFound
from freerein.types.sim import DemonstrateRequest, ListTasksRequest
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.work import Work

pytestmark = pytest.mark.e2e
COLLECT = KINDS["collect"]
EXPERT = {"task": "grid", "dataset": "demos", "count": 40, "max_skills": 2, "seed": 3}
RANDOM = {"task": "grid", "dataset": "demos", "behaviour": "random", "count": 6}

CURIOSITY = {"task": "grid", "dataset": "demos", "behaviour": "curiosity", "count": 18, "num_envs": 2, "length": 8}


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any]) -> Any:
    return start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1")


@pytest.fixture
def begin(tmp_path: Path, sim: Any) -> Iterator[Callable[..., Work]]:
    """A function that returns a run's work: `begin({"task": ...}, stop=...)`; what it opened is closed in the end."""
    begun: list[Work] = []

    def begin(
        config: dict[str, Any], *, name: str = "run", address: str = sim.address, stop: Callable[[], bool] = bool
    ) -> Work:
        folder = tmp_path / "runs" / name
        folder.mkdir(parents=True, exist_ok=True)
        environ = {"FREEREIN_SIM_ADDRESS": address}
        begun.append(Work(folder, name, COLLECT.resolve(config), tmp_path, "cpu", environ, stop))
        return begun[-1]

    yield begin
    for work in begun:
        work.closing.close()


def recorded(root: Path, sim: Any, request: DemonstrateRequest) -> str:
    """Returns the fingerprint of a dataset recorded without a run, and without disturbance."""
    with SyncClient(SimClient(Channel(sim.address))) as client:
        recording = DatasetRecorder(root, request, client.list_tasks(ListTasksRequest()))
        with recording, closing(client.demonstrate(recording.remaining)) as demonstrations:
            for demonstration in demonstrations:
                recording.append(demonstration)
    return Dataset(root).fingerprint


def rows(work: Work) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (work.folder / "metrics.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("config", [EXPERT, RANDOM], ids=["expert", "random"])
def test_a_run_records_what_the_same_request_does_and_says_what_it_left(
    begin: Callable[..., Work], sim: Any, tmp_path: Path, config: dict[str, Any]
) -> None:
    work = begin(config)
    assert COLLECT.run(work)

    request = {"behaviour": "expert", **config}
    del request["dataset"]
    fingerprint = recorded(tmp_path / "plain", sim, DemonstrateRequest(**request))
    dataset, card = Dataset(dataset_path(tmp_path, "demos")), json.loads((work.artifacts / "dataset.json").read_bytes())
    assert dataset.fingerprint == fingerprint
    assert card == {
        "dataset": "demos",
        "trajectories": config["count"],
        "timesteps": dataset.lengths.sum(),
        "fingerprint": fingerprint,
    }
    assert rows(work)[-1] == {"step": config["count"], "timesteps": dataset.lengths.sum()}


def test_a_stopped_run_goes_on_and_records_nothing_twice(begin: Callable[..., Work], sim: Any, tmp_path: Path) -> None:
    asked: list[None] = []

    def stop_after_three() -> bool:
        asked.append(None)
        return len(asked) > 3  # it is asked before the first, too

    assert not COLLECT.run(begin(RANDOM, stop=stop_after_three))
    assert len(Dataset(dataset_path(tmp_path, "demos"))) == 3
    work = begin(RANDOM)
    assert COLLECT.run(work)

    fingerprint = recorded(tmp_path / "plain", sim, DemonstrateRequest("grid", "random", count=6))
    assert Dataset(dataset_path(tmp_path, "demos")).fingerprint == fingerprint
    steps = [row["step"] for row in rows(work)]
    assert steps == sorted(set(steps))


@pytest.mark.parametrize(
    ("config", "killed_at", "replaced_at"),
    [(EXPERT | {"count": 200}, 20, 5), (CURIOSITY | {"count": 12}, 2, 25)],
    ids=["expert", "curiosity"],
)
def test_a_child_killed_and_a_sim_killed_leave_the_dataset_of_an_undisturbed_run(
    begin: Callable[..., Work],
    start_service: Callable[..., Any],
    tmp_path: Path,
    config: dict[str, Any],
    killed_at: int,
    replaced_at: int,
) -> None:
    mortal = start_service("freerein_sim", FREEREIN_SIM_WORKERS="1")
    port, asked, root = mortal.address.rpartition(":")[2], list[None](), dataset_path(tmp_path, "demos")

    def replace_the_sim() -> bool:
        asked.append(None)
        if len(asked) == replaced_at:
            mortal.process.kill()
            mortal.process.wait()
            start_service("freerein_sim", FREEREIN_SIM_WORKERS="1", FREEREIN_GRPC_PORT=port)
        return False

    work = begin(config, address=mortal.address, stop=replace_the_sim)
    with child_of(work) as child:
        wait_for(root, killed_at, child)
        child.kill()
    assert len(Dataset(root)) < config["count"]
    assert COLLECT.run(work)
    assert len(asked) > replaced_at
    assert COLLECT.run(begin(config | {"dataset": "plain"}, name="plain"))
    assert Dataset(root).fingerprint == Dataset(dataset_path(tmp_path, "plain")).fingerprint


def test_all_that_curiosity_did_is_recorded_as_trajectories_within_episodes(
    begin: Callable[..., Work], tmp_path: Path
) -> None:
    work = begin(CURIOSITY)
    assert COLLECT.run(work)

    dataset = Dataset(dataset_path(tmp_path, "demos"))
    assert len(dataset) == CURIOSITY["count"]
    assert dataset.lengths.tolist() == [8] * 12 + [2, 2, 6, 6] + [8] * 2  # an episode has 50
    assert dataset.skills == ((),) * len(dataset)
    assert [row["step"] for row in rows(work)] == [2, 4, 6, 8, 10, 12, 16, 18]
    assert all(row["surprise"] > 0 for row in rows(work))


@contextmanager
def child_of(work: Work) -> Iterator["subprocess.Popen[bytes]"]:
    (work.folder / "config.json").write_text(json.dumps({"kind": "collect", "config": work.config}))
    command = [sys.executable, "-m", "freerein_orchestrator.child", str(work.folder), str(work.data_dir), "cpu"]
    environ = {**os.environ, **work.environ, "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(command, stdin=subprocess.PIPE, env=environ) as child:
        yield child


def wait_for(root: Path, trajectories: int, child: "subprocess.Popen[bytes]") -> None:
    """Returns when a child has recorded more than so many trajectories."""
    while not (root / "data/chunk-000" / f"file-{trajectories:03d}.parquet").exists():
        with suppress(subprocess.TimeoutExpired):
            pytest.fail(f"The child ended with {child.wait(0.02)}.")


def test_a_run_told_to_stop_while_its_sim_is_away_stops(begin: Callable[..., Work]) -> None:
    asked: list[None] = []

    def stop_when_asked_again() -> bool:
        asked.append(None)
        return len(asked) > 3

    assert not COLLECT.run(begin(EXPERT, address="127.0.0.1:9", stop=stop_when_asked_again))


def test_what_no_run_can_record_is_refused(begin: Callable[..., Work]) -> None:
    with pytest.raises(InvalidInput, match="Only the expert"):
        COLLECT.resolve(RANDOM | {"max_skills": 1})
    with pytest.raises(InvalidInput, match="one camera"):
        COLLECT.resolve(CURIOSITY | {"cameras": ["top", "side"]})
    with pytest.raises(InvalidInput):
        COLLECT.resolve(RANDOM | {"dataset": "../demos"})
    with pytest.raises(NotFound):
        COLLECT.run(begin(RANDOM | {"task": "nothing"}))
    assert COLLECT.run(begin(RANDOM, name="first"))
    with pytest.raises(FailedPrecondition, match="another"):
        COLLECT.run(begin(RANDOM | {"seed": 1}, name="second"))
