"""Attempts at jobs, each with a real child process: what ends them, and what only interrupts them."""

import os
import resource
import shutil
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import psutil
import pytest

from freerein.jobs.attempt import AttemptRunner, AttemptStopped, StopRequest
from freerein.jobs.retry import AttemptResult, Pause, retry
from freerein.jobs.store import JobStore

START = {"kind": "ppo", "config": {}, "idempotency_key": ""}


@pytest.fixture
def store(tmp_path: Path) -> JobStore:
    return JobStore(tmp_path / "runs", noun="run")


@pytest.fixture
def runner(store: JobStore, monkeypatch: pytest.MonkeyPatch) -> AttemptRunner:
    return toy_runner(store, monkeypatch)


def toy_runner(store: JobStore, monkeypatch: pytest.MonkeyPatch, **options: float) -> AttemptRunner:
    toys = Path(__file__).parents[1] / "orchestrator"
    monkeypatch.setenv("PYTHONPATH", f"{toys}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    hidden = ("FREEREIN_DATABASE_URL",)
    return AttemptRunner(store, module="toy_child", arguments=("here",), hidden_env=hidden, **options)


def go_on() -> StopRequest:
    return ""


def test_a_run_that_this_worker_cannot_see_fails_and_says_what_workers_must_share(store, runner):
    attempt = runner.run("f" * 32, go_on)
    assert attempt.outcome == "failed"
    assert "FREEREIN_DATA_DIR" in attempt.error
    assert not store.folder("f" * 32).exists()


@pytest.mark.parametrize(
    ("results", "end"),
    [
        ("crashed crashed crashed", ("failed", "3 attempts in a row ended without progress. No.")),
        ("crashed crashed progressed crashed crashed succeeded", ("succeeded", "")),
        ("progressed failed", ("failed", "No.")),
        ("killed " * 10, ("failed", "10 attempts in a row ended without progress. No.")),
        ("killed " * 9 + "progressed " + "killed " * 9 + "succeeded", ("succeeded", "")),
        ("crashed killed crashed killed crashed", ("failed", "5 attempts in a row ended without progress. No.")),
    ],
)
def test_a_job_is_attempted_until_it_ends_or_three_crash_or_ten_are_killed_without_progress(results, end):
    made = iter(results.split())

    def attempt(_pause: Pause) -> AttemptResult:
        match next(made):
            case "progressed":
                return AttemptResult("crashed", progressed=True)
            case "succeeded":
                return AttemptResult("succeeded")
            case outcome:
                return AttemptResult(outcome, error="No.")

    result = retry(attempt)
    assert (result.outcome, result.error) == end
    assert next(made, None) is None


@pytest.mark.fault("F8")
def test_after_each_kill_in_a_row_the_next_attempt_waits_twice_as_long_up_to_a_minute():
    ends = ["killed"] * 9
    ends += ["progressed", "killed", "crashed", "crashed", "killed", "progressed", "killed", "succeeded"]
    pauses: list[float] = []

    def attempt(pause: Pause) -> AttemptResult:
        pauses.append(pause.seconds)
        end = ends[len(pauses) - 1]
        return AttemptResult("killed", progressed=True) if end == "progressed" else AttemptResult(end)

    assert retry(attempt).outcome == "succeeded"
    assert pauses == [0, 0.5, 1, 2, 4, 8, 16, 32, 60, 60, 0, 0.5, 0, 0, 0.5, 0, 0.5]


def test_every_row_of_metrics_is_an_event_and_a_step_that_is_done_again_is_not(store, runner):
    run_id = store.create(START, {"config": {"steps": 4}})
    store.record(run_id, "running", step=2)  # by an attempt before
    assert runner.run(run_id, go_on) == AttemptResult("succeeded")
    assert [(event.step, event.metrics) for event in store.events(run_id)()[2:]] == [
        (3, {"loss": 1 / 3}),
        (4, {"loss": 1 / 4}),
    ]


@pytest.mark.fault("F16")
@pytest.mark.parametrize(("wait_at", "outcome"), [(2, "crashed"), (0, "failed")])
def test_a_child_at_a_standstill_is_ended_and_tried_again_only_where_it_had_progressed(
    store, monkeypatch, wait_at, outcome
):
    run_id = store.create(START, {"config": {"steps": 3, "wait_at": wait_at, "killed": int(not wait_at)}})
    attempt = toy_runner(store, monkeypatch, standstill_s=4.0).run(run_id, go_on)
    assert (attempt.outcome, attempt.progressed) == (outcome, wait_at > 0)
    assert "did nothing for 4 s" in attempt.error
    assert not psutil.pid_exists(int((store.folder(run_id) / "pids.txt").read_text()))


@pytest.mark.fault("O5")
def test_an_attempt_that_could_not_begin_is_tried_again(store, runner):
    run_id = store.create(START, {"config": {"steps": 1}})
    (store.folder(run_id) / "log.txt").mkdir()
    attempt = runner.run(run_id, go_on)
    assert (attempt.outcome, attempt.error) == ("crashed", "The child process could not be started: Is a directory.")


@pytest.mark.fault("C22")
def test_an_attempt_without_files_to_begin_with_is_tried_again_after_a_pause(store, runner):
    run_id = store.create(START, {"config": {"steps": 1}})
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (psutil.Process().num_fds(), before[1]))
    with ExitStack() as taken:
        taken.callback(resource.setrlimit, resource.RLIMIT_NOFILE, before)
        with suppress(OSError):
            while True:  # the limit is of numbers, and free ones below it may be left
                taken.callback(os.close, os.dup(0))
        attempt = runner.run(run_id, go_on)
    assert (attempt.outcome, attempt.error) == (
        "killed",
        "The child process could not be started: Too many open files.",
    )


@pytest.mark.fault("C22")
def test_an_attempt_whose_files_cannot_be_read_ends_its_child_and_is_tried_again_after_a_pause(store, runner):
    run_id = store.create(START, {"config": {"steps": 1, "wait_at": 1}})
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    with ExitStack() as taken:
        taken.callback(resource.setrlimit, resource.RLIMIT_NOFILE, before)

        def take_all_files() -> StopRequest:
            if (store.folder(run_id) / "metrics.jsonl").exists():
                resource.setrlimit(resource.RLIMIT_NOFILE, (psutil.Process().num_fds(), before[1]))
                with suppress(OSError):
                    while True:
                        taken.callback(os.close, os.dup(0))
            return ""

        attempt = runner.run(run_id, take_all_files)
    assert (attempt.outcome, attempt.error) == (
        "killed",
        "The child process was ended, for its files could not be read: Too many open files.",
    )
    assert not psutil.pid_exists(int((store.folder(run_id) / "pids.txt").read_text()))


def test_a_child_whose_job_is_deleted_is_ended(store, runner):
    run_id = store.create(START, {"config": {"steps": 1, "wait_at": 1}})
    pids: list[int] = []

    def delete_once_it_runs() -> StopRequest:
        if not pids and (store.folder(run_id) / "metrics.jsonl").exists():
            pids.append(int((store.folder(run_id) / "pids.txt").read_text()))
            shutil.rmtree(store.folder(run_id))
        return ""

    attempt = runner.run(run_id, delete_once_it_runs)
    assert (attempt.outcome, "must not be deleted" in attempt.error) == ("failed", True)
    assert not psutil.pid_exists(pids[0])


@pytest.mark.fault("O10")
def test_a_child_that_will_not_end_is_killed_a_second_after_a_cancel(store, runner, monkeypatch):
    monkeypatch.setenv("FREEREIN_DATABASE_URL", "postgresql://user:secret@host/name")
    run_id = store.create(START, {"config": {"steps": 3, "wait_at": 2, "deaf": True}})
    told: list[float] = []

    def cancel_at_two() -> StopRequest:
        if store.last(run_id).step < 2:
            return ""
        pid = int((store.folder(run_id) / "pids.txt").read_text())
        assert not told
        assert "FREEREIN_DATABASE_URL" not in psutil.Process(pid).environ()
        told.append(time.monotonic())
        return "cancel"

    with pytest.raises(AttemptStopped):
        runner.run(run_id, cancel_at_two)
    assert 1 < time.monotonic() - told[0] < 20
    assert not psutil.pid_exists(int((store.folder(run_id) / "pids.txt").read_text()))
