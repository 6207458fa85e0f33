"""A disk that is full or read-only: calls that write are refused whole, reads go on, and nothing is lost or halved."""

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from tests.faults.demonstrations import record_demonstrations
from tests.waiting import wait_until
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.clients import Channel, FitClient, OrchestratorClient, SyncClient
from freerein.errors import OutOfStorage
from freerein.types.learning import StartFitRequest
from freerein.types.orchestrator import StartRunRequest

pytestmark = pytest.mark.e2e
FIT = {"steps": 40, "checkpoint_every": 10, "log_every": 1, "features": 8, "hidden_size": 8}
RUN = {"task": "grid", "dataset": "few", "count": 1}
STATES = ("full", "read_only")


class Disk:
    """A file system of 24 MiB of its own."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._ballast = path / "ballast"

    def mount(self, *options: str) -> None:
        subprocess.run(["mount", "-t", "tmpfs", "-o", ",".join(("size=24m", *options)), "tmpfs", self.path], check=True)

    def unmount(self) -> None:
        subprocess.run(["umount", self.path], check=True)

    @contextmanager
    def full(self) -> Iterator[None]:
        with self._ballast.open("wb", buffering=0) as file:
            for size in (1 << 20, 4096, 1):  # to the last byte
                try:
                    while file.write(bytes(size)):
                        pass
                except OSError:
                    continue
        try:
            yield
        finally:
            self._ballast.unlink()

    @contextmanager
    def read_only(self) -> Iterator[None]:
        self.mount("remount", "ro")
        try:
            yield
        finally:
            self.mount("remount", "rw")

    @property
    def files(self) -> list[str]:
        """Every file but the lock that excludes others while a job is made."""
        paths = [path for path in self.path.rglob("*") if path.is_file() and path.name != ".lock"]
        return sorted(str(path.relative_to(self.path)) for path in paths if path != self._ballast)


@pytest.fixture(scope="module")
def new_disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[], Disk]]:
    if os.geteuid() != 0:
        pytest.skip("needs root: only it may mount a file system")
    disks: list[Disk] = []

    def new() -> Disk:
        disks.append(Disk(tmp_path_factory.mktemp("disk")))
        disks[-1].mount()
        return disks[-1]

    yield new
    for disk in disks:
        subprocess.run(["umount", "--lazy", disk.path], check=True)  # the services on it end later


@pytest.fixture(scope="module")
def disk(new_disk: Callable[[], Disk]) -> Disk:
    """The disk of the segmentation service, with demonstrations on it."""
    disk = new_disk()
    record_demonstrations(disk.path)
    return disk


@pytest.fixture(scope="module")
def faulty(start_faulty: Any, disk: Disk, tmp_path_factory: pytest.TempPathFactory) -> Any:
    return start_faulty(tmp_path_factory.mktemp("log"), FREEREIN_DATA_DIR=str(disk.path))


@pytest.fixture(scope="module")
def undisturbed(faulty: Any) -> str:
    """Version of the model of a fit that nobody disturbed."""
    ended = wait_for(faulty, start_fit(faulty, "undisturbed"), lambda fit: fit["state"] == "succeeded")
    return str(ended["model"]["version"])


def start_fit(faulty: Any, key: str) -> str:
    reply = faulty.http.post("/v1/start-fit", json={"dataset": "demos", "config": FIT, "idempotency_key": key})
    assert reply.status_code == 200, reply.text
    return str(reply.json()["fit"]["id"])


def wait_for(faulty: Any, fit_id: str, condition: Callable[[Any], bool]) -> Any:
    """Waits until a fit meets a condition; returns it."""
    fit: Any = None

    def met() -> bool:
        nonlocal fit
        fit = faulty.http.get("/v1/get-fit", params={"id": fit_id}).json()["fit"]
        return condition(fit)

    wait_until(met)
    return fit


@pytest.mark.fault("F9")
@pytest.mark.fault("C21")
@pytest.mark.parametrize("state", STATES)
def test_a_fit_is_refused_whole_and_begun_later_by_the_same_key(
    faulty: Any, disk: Disk, refusal: Any, state: str
) -> None:
    asked = {"dataset": "demos", "config": FIT, "idempotency_key": state}
    known = len(faulty.http.get("/v1/list-fits").json()["fits"])
    with getattr(disk, state)():
        before = disk.files
        assert refusal(faulty.http.post("/v1/start-fit", json=asked), 507)["code"] == "out_of_storage"
        with (
            SyncClient(FitClient(Channel(faulty.service.address))) as fits,
            pytest.raises(OutOfStorage, match="must work") as refused,
        ):
            fits.start_fit(StartFitRequest("demos", "", FIT, state))
        assert "same idempotency key" in refused.value.hint
        assert disk.files == before
        assert faulty.http.get("/readyz").status_code == 200
        assert faulty.segment().status_code == 200
        assert len(faulty.http.get("/v1/list-fits").json()["fits"]) == known
    fit_id = start_fit(faulty, state)
    assert start_fit(faulty, state) == fit_id
    assert faulty.http.post("/v1/cancel-fit", json={"id": fit_id}).json()["fit"]["state"] == "cancelled"


@pytest.mark.fault("C21")
@pytest.mark.parametrize("state", STATES)
def test_a_model_that_cannot_be_activated_leaves_the_active_one(
    faulty: Any, disk: Disk, refusal: Any, state: str
) -> None:
    models = faulty.http.get("/v1/list-models").json()
    with getattr(disk, state)():
        before = disk.files
        asked = {"version": models["models"][-1]["ref"]["version"]}
        assert refusal(faulty.http.post("/v1/activate-model", json=asked), 507)["code"] == "out_of_storage"
        assert disk.files == before
        assert faulty.http.get("/v1/list-models").json() == models
    assert faulty.http.post("/v1/activate-model", json=asked).status_code == 200


@pytest.mark.fault("F9")
@pytest.mark.fault("C21")
def test_a_fit_that_was_cancelled_and_that_failed_on_a_full_disk_is_resumed_to_the_same_bits(
    faulty: Any, disk: Disk, undisturbed: str
) -> None:
    fit_id = start_fit(faulty, "disturbed")
    suspended_child(faulty)
    assert faulty.http.post("/v1/cancel-fit", json={"id": fit_id}).json()["fit"]["state"] == "cancelled"
    resumed = CliRunner().invoke(
        app,
        ["fit", "resume", fit_id, "--service", "segmentation", "--json"],
        env={"FREEREIN_SEGMENTATION_ADDRESS": faulty.service.address},
    )
    assert json.loads(resumed.stdout)["state"] in ("queued", "running")
    assert faulty.http.post("/v1/resume-fit", json={"id": fit_id}).status_code == 409
    child = suspended_child(faulty)
    with disk.full():
        child.resume()
        failed = wait_for(faulty, fit_id, lambda fit: fit["state"] == "failed")
    assert "must be writable" in failed["error"] or "must work" in failed["error"]  # its checkpoints, or another file
    assert "resume the fit" in failed["error"]
    assert faulty.http.post("/v1/resume-fit", json={"id": fit_id}).status_code == 200
    assert wait_for(faulty, fit_id, lambda fit: "model" in fit)["model"]["version"] == undisturbed


def suspended_child(faulty: Any) -> psutil.Process:
    """Returns the child of the fit that has begun, which ends no sooner than it is resumed."""
    wait_until(lambda: faulty.jobs)
    child: psutil.Process = faulty.jobs[0]
    child.suspend()
    return child


@pytest.fixture(scope="module")
def runs_disk(new_disk: Callable[[], Disk]) -> Disk:
    """The disk of the orchestrator."""
    return new_disk()


@pytest.mark.fault("F9")
def test_an_orchestrator_waits_for_room_to_begin_and_refuses_runs_whole(
    start_faulty: Any, runs_disk: Disk, refusal: Any, tmp_path_factory: pytest.TempPathFactory
) -> None:
    with runs_disk.full():
        orchestrator = start_faulty(
            tmp_path_factory.mktemp("log"),
            module="freerein_orchestrator",
            FREEREIN_DATA_DIR=str(runs_disk.path),
            FREEREIN_SIM_ADDRESS="127.0.0.1:1",
        )
        wait_until(lambda: "disk is full" in orchestrator.http.get("/readyz").text)
    wait_until(lambda: orchestrator.http.get("/readyz").status_code == 200)
    asked = {"kind": "collect", "config": RUN, "idempotency_key": "once"}
    with runs_disk.full():
        before = runs_disk.files
        assert refusal(orchestrator.http.post("/v1/start-run", json=asked), 507)["code"] == "out_of_storage"
        with (
            SyncClient(OrchestratorClient(Channel(orchestrator.service.address))) as runs,
            pytest.raises(OutOfStorage, match="No space left"),
        ):
            runs.start_run(StartRunRequest("collect", RUN, "once"))
        assert runs_disk.files == before
        assert orchestrator.http.get("/v1/list-runs").json()["runs"] == []
    run_id = orchestrator.http.post("/v1/start-run", json=asked).json()["run"]["id"]
    assert orchestrator.http.post("/v1/start-run", json=asked).json()["run"]["id"] == run_id
    assert orchestrator.http.post("/v1/cancel-run", json={"id": run_id}).json()["run"]["state"] == "cancelled"


@pytest.mark.fault("F9")
def test_an_orchestrator_that_starts_again_on_a_full_disk_waits_for_room_and_ends_when_told_to(
    start_faulty: Any, new_disk: Callable[[], Disk], tmp_path_factory: pytest.TempPathFactory
) -> None:
    disk = new_disk()

    def start() -> Any:
        where = {"FREEREIN_DATA_DIR": str(disk.path), "FREEREIN_SIM_ADDRESS": "127.0.0.1:1"}
        return start_faulty(tmp_path_factory.mktemp("log"), module="freerein_orchestrator", **where)

    def waits(orchestrator: Any) -> bool:
        return "disk is full" in orchestrator.http.get("/readyz").text

    first = start()
    wait_until(lambda: first.http.get("/readyz").status_code == 200)
    assert first.service.stop() == 0
    with disk.full():
        told = start()
        wait_until(lambda: waits(told))
        assert told.service.stop() == 0
        after = start()
        wait_until(lambda: waits(after))
    wait_until(lambda: after.http.get("/readyz").status_code == 200)


@pytest.mark.fault("C21")
def test_a_run_that_records_data_goes_on_once_there_is_room(
    start_faulty: Any, new_disk: Callable[[], Disk], tmp_path_factory: pytest.TempPathFactory, fuzz: bool
) -> None:
    if not fuzz:
        pytest.skip("a case of `make fuzz`")
    disk = new_disk()
    sim = start_faulty(tmp_path_factory.mktemp("sim"), module="freerein_sim", FREEREIN_SIM_WORKERS="1")
    orchestrator = start_faulty(
        tmp_path_factory.mktemp("log"),
        module="freerein_orchestrator",
        FREEREIN_DATA_DIR=str(disk.path),
        FREEREIN_SIM_ADDRESS=sim.service.address,
    )
    wait_until(lambda: orchestrator.http.get("/readyz").status_code == 200)
    asked = {"kind": "collect", "config": {**RUN, "count": 150}}
    run_id = orchestrator.http.post("/v1/start-run", json=asked).json()["run"]["id"]

    def run() -> Any:
        return orchestrator.http.get("/v1/get-run", params={"id": run_id}).json()["run"]

    wait_until(lambda: run()["step"] >= 5)
    with disk.full():
        wait_until(lambda: not orchestrator.jobs)
    wait_until(lambda: run()["state"] in ("succeeded", "failed"))
    if run()["state"] == "failed":  # its end could be recorded before the disk was full to the last byte
        assert "must be writable" in run()["error"] or "must work" in run()["error"]
        assert orchestrator.http.post("/v1/resume-run", json={"id": run_id}).status_code == 200
        wait_until(lambda: run()["state"] == "succeeded")
    assert run()["step"] == 150
