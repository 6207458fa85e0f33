"""Told to stop, killed, or started wrongly: what was promised is kept, and the exit code says what happened."""

import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest
from tests.faults.demonstrations import record_demonstrations

from freerein.model_store import ModelStore

pytestmark = pytest.mark.e2e
FAULTY_SERVICE = "tests.faults.faulty_service"
RunBadly = Callable[..., tuple[int, str]]
CHECKPOINT_EVERY = 5


# --- a fit that runs


def start_fit(faulty: Any, *, steps: int = 100_000) -> str:
    config = {"steps": steps, "log_every": 1, "checkpoint_every": CHECKPOINT_EVERY, "features": 8, "hidden_size": 8}
    reply = faulty.http.post("/v1/start-fit", json={"dataset": "demos", "config": config, "idempotency_key": "once"})
    assert reply.status_code == 200, reply.text
    fit_id: str = reply.json()["fit"]["id"]
    return fit_id


def fit(faulty: Any, fit_id: str) -> Any:
    return faulty.http.get("/v1/get-fit", params={"id": fit_id}).json()["fit"]


# --- SIGTERM


@pytest.mark.fault("C18")
def test_on_sigterm_while_starting_it_stops(start_service: Callable[..., Any]) -> None:
    assert start_service("freerein_sim").stop() == 0  # its workers are still starting


@pytest.mark.fault("F3")
def test_on_sigterm_it_does_not_wait_for_a_thread_that_hangs(
    start_service: Callable[..., Any], wait_until: Any
) -> None:
    service = start_service(FAULTY_SERVICE, FAULTY_LOAD="hangs")  # in a thread of those that decode
    wait_until(lambda: "hanging" in service.log.read_text(), 300)
    assert service.stop() == 0
    assert '"stopped"' in service.log.read_text().splitlines()[-1]


@pytest.mark.fault("C18")
def test_on_sigterm_it_ends_in_time_though_it_waits_for_a_fit_whose_model_hangs_as_it_is_loaded(
    start_faulty: Callable[..., Any], tmp_path: Path, wait_until: Any
) -> None:
    record_demonstrations(tmp_path)
    faulty = start_faulty(tmp_path, FAULTY_LOAD="hangs when fitted")
    faulty.service.until_ready()
    start_fit(faulty, steps=1)
    wait_until(lambda: "hanging" in faulty.service.log.read_text(), 300)
    assert faulty.service.stop() == 1
    assert '"did not stop in time"' in faulty.service.log.read_text().splitlines()[-1]


# --- SIGKILL


@pytest.mark.fault("C19")
def test_after_sigkill_it_has_its_models_and_resumes_its_fit(
    start_faulty: Callable[..., Any], tmp_path: Path, wait_until: Any, least_of_many: Callable[..., float]
) -> None:
    record_demonstrations(tmp_path)
    first = second = start_faulty(tmp_path)
    fit_id = start_fit(first)
    wait_until(lambda: fit(first, fit_id)["step"] > 3 * CHECKPOINT_EVERY, 300)
    reached, models, child = fit(first, fit_id), first.http.get("/v1/list-models").json(), first.jobs[0]

    def seconds_away() -> float:
        nonlocal second
        second.service.kill()
        second.service.process.wait()
        begun = time.monotonic()
        second = start_faulty(tmp_path)
        wait_until(lambda: second.http.get("/readyz").status_code == 200, 300)
        return time.monotonic() - begun

    assert least_of_many(seconds_away, below=30) < 30
    wait_until(lambda: not child.is_running() or child.status() == psutil.STATUS_ZOMBIE, 60)
    assert second.http.get("/v1/list-models").json() == models
    assert start_fit(second) == fit_id  # the idempotency key is remembered
    wait_until(lambda: fit(second, fit_id)["step"] != reached["step"], 300)
    resumed = fit(second, fit_id)
    assert resumed["step"] > reached["step"] - 2 * CHECKPOINT_EVERY  # a new start would begin at 1
    moved_on = {"step": 0, "metrics": 0, "time_ns": 0}
    assert {**resumed, **moved_on} == {**reached, **moved_on}
    assert second.metric('freerein_jobs{kind="fit",state="running"}') == 1
    assert second.http.post("/v1/cancel-fit", json={"id": fit_id}).json()["fit"]["state"] == "cancelled"
    assert second.metric('freerein_jobs{kind="fit",state="cancelled"}') == 1
    assert second.metric("freerein_data_free_bytes") > 0
    assert second.jobs == []


# --- starts that cannot succeed


def reason(stderr: str) -> str:
    """Returns the one line that says why a service could not start."""
    assert "Traceback" not in stderr
    lines = [line for line in stderr.splitlines() if not line.startswith("{")]
    assert len(lines) == 1, stderr
    assert lines[0].startswith("cannot start: ")
    return lines[0]


@pytest.mark.fault("C20")
@pytest.mark.parametrize(
    ("variable", "value", "fix"),
    [
        ("FREEREIN_HTTP_PORT", "http", "FREEREIN_HTTP_PORT: Input should be a valid integer"),
        ("FREEREIN_HOST", "0.0.0.0", "set FREEREIN_INSECURE=1"),
        ("FREEREIN_HOST", "no-such-host.invalid", "Set FREEREIN_HOST"),
        ("FREEREIN_TOKN", "abc", "did you mean `FREEREIN_TOKEN`?"),
    ],
)
def test_a_wrong_setting_ends_the_start_with_its_name(
    run_badly: RunBadly, tmp_path: Path, variable: str, value: str, fix: str
) -> None:
    token = "x" if "no-such" in value else ""
    code, stderr = run_badly("freerein_sim", tmp_path, **{"FREEREIN_TOKEN": token, variable: value})
    assert code == 3
    assert fix in reason(stderr)


@pytest.mark.fault("C20")
@pytest.mark.parametrize(
    ("module", "variable", "value", "fix"),
    [
        *(
            (f"freerein_{name}", "FREEREIN_DEVICE", "cuda:99", "must be a device of this machine")
            for name in ("imitation", "orchestrator", "reward", "segmentation")
        ),
        ("freerein_imitation", "FREEREIN_DATA_DIR", "/proc/none/data", "one that can be made"),
        ("freerein_orchestrator", "FREEREIN_DATA_DIR", "/proc/none/data", "one that can be made"),
        ("freerein_orchestrator", "FREEREIN_SIM_ADDRESS", "sim", "FREEREIN_SIM_ADDRESS must hold host:port"),
    ],
)
def test_a_setting_that_this_machine_cannot_meet_ends_the_start_with_its_name(
    run_badly: RunBadly, tmp_path: Path, module: str, variable: str, value: str, fix: str
) -> None:
    code, stderr = run_badly(module, tmp_path, **{variable: value})
    assert code == 3
    assert fix in reason(stderr)


@pytest.mark.fault("C20")
def test_a_start_that_cannot_succeed_soon_ends(
    run_badly: RunBadly, tmp_path: Path, least_of_many: Callable[..., float]
) -> None:
    def seconds() -> float:
        begun = time.monotonic()
        run_badly("freerein_sim", tmp_path, FREEREIN_QUEUE="0")
        return time.monotonic() - begun

    assert least_of_many(seconds, below=20) < 20


@pytest.mark.fault("C20")
@pytest.mark.parametrize("variable", ["FREEREIN_HTTP_PORT", "FREEREIN_GRPC_PORT"])
def test_a_taken_port_ends_the_start_with_the_names_of_both(run_badly: RunBadly, tmp_path: Path, variable: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as holder:
        port = str(holder.getsockname()[1])
        code, stderr = run_badly("freerein_sim", tmp_path, **{variable: port})
    assert code == 3
    assert port in reason(stderr)
    assert "FREEREIN_HTTP_PORT and FREEREIN_GRPC_PORT" in reason(stderr)


@pytest.mark.fault("C20")
def test_damaged_weights_end_the_start_with_the_name_of_the_model(run_badly: RunBadly, tmp_path: Path) -> None:
    store, folder = ModelStore(tmp_path / "models" / "segmentation"), tmp_path / "unpublished"
    folder.mkdir()
    (folder / "weights").write_bytes(bytes(range(256)))
    (folder / "card.json").write_text("{}")
    ref = store.publish("", folder)
    store.activate(ref)
    weights = store.folder(ref) / "weights"
    weights.write_bytes(weights.read_bytes().replace(b"\x10", b"\x11"))
    code, stderr = run_badly(FAULTY_SERVICE, tmp_path)
    assert code == 3
    assert ref.version in reason(stderr)
    assert "fit the model again" in reason(stderr)
