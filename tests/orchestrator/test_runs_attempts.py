"""Attempts at runs, each with a real child process: what ends them, and what only interrupts them."""

import time
from pathlib import Path

import psutil
import pytest

from freerein.types.orchestrator import StartRunRequest
from freerein_orchestrator.outcomes import Interrupted, Reason
from freerein_orchestrator.runs.attempts import Attempts
from freerein_orchestrator.runs.records import RunRecords


@pytest.fixture
def records(tmp_path: Path) -> RunRecords:
    return RunRecords(tmp_path / "runs")


@pytest.fixture
def attempts(records: RunRecords, monkeypatch: pytest.MonkeyPatch) -> Attempts:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    return Attempts(records, module="toy_child")


def go_on() -> Reason:
    return ""


def test_a_run_that_this_worker_cannot_see_fails_and_says_what_workers_must_share(records, attempts):
    attempt = attempts.make("f" * 32, go_on)
    assert attempt.outcome == "failed"
    assert "FREEREIN_DATA_DIR" in attempt.reason
    assert not records.folder("f" * 32).exists()


def test_a_run_that_is_being_made_has_not_ended_whatever_was_noted_last(records, attempts):
    run_id = records.add(StartRunRequest("ppo", {}), {"steps": 1})
    records.note(run_id, "failed", reason="No.")
    assert attempts.make(run_id, go_on).outcome == "succeeded"
    states = [event.state for event in records.watch(run_id).read()]
    assert states[:4] == ["queued", "failed", "queued", "running"]
    assert records.last(run_id).step == 1


@pytest.mark.fault("O5")
def test_an_attempt_that_could_not_begin_is_tried_again(records, attempts):
    run_id = records.add(StartRunRequest("ppo", {}), {"steps": 1})
    (records.folder(run_id) / "log.txt").mkdir()
    attempt = attempts.make(run_id, go_on)
    assert (attempt.outcome, attempt.reason) == ("crashed", "It could not be made: Is a directory.")


@pytest.mark.fault("O10")
def test_a_child_that_will_not_end_is_killed_within_two_seconds_of_a_cancel(records, attempts, monkeypatch):
    monkeypatch.setenv("FREEREIN_DATABASE_URL", "postgresql://user:secret@host/name")
    run_id = records.add(StartRunRequest("ppo", {}), {"steps": 3, "wait_at": 2, "deaf": True})
    told: list[float] = []

    def cancel_at_two() -> Reason:
        if records.last(run_id).step < 2:
            return ""
        pid = int((records.folder(run_id) / "pids.txt").read_text())
        assert not told
        assert "FREEREIN_DATABASE_URL" not in psutil.Process(pid).environ()
        told.append(time.monotonic())
        return "cancel"

    with pytest.raises(Interrupted):
        attempts.make(run_id, cancel_at_two)
    assert 1 < time.monotonic() - told[0] < 2
    assert not psutil.pid_exists(int((records.folder(run_id) / "pids.txt").read_text()))
