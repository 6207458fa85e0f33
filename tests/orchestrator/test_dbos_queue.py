"""Runs survive: real workers and real children are killed, and every run ends as what it is, nothing done twice."""

import contextlib
import json
import os
import resource
import shutil
import signal
import sqlite3
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import psycopg
import pytest

from freerein.fork_server import Program, StartChild
from freerein.jobs.attempt import CANCELLED_FILE

pytestmark = pytest.mark.e2e
_MODULE = "tests.orchestrator.toy_worker"
Reply = Any


class Worker:
    """An orchestrator process without REST and gRPC, on a data directory of its own or shared with others."""

    def __init__(self, start: StartChild, data_dir: Path, name: str = "worker", url: str = "") -> None:
        self.runs = data_dir / "runs"
        environ = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "error"}
        (stdin, commands), (replies, stdout) = os.pipe(), os.pipe()
        self._commands, self._replies = os.fdopen(commands, "w"), os.fdopen(replies)
        with (data_dir / f"{name}.log").open("ab") as log, os.fdopen(stdin), os.fdopen(stdout):
            arguments = str(data_dir), name, url
            self.process = start(Program(_MODULE, arguments, environ, stdin, stdout, log.fileno()))

    def opened(self) -> "Worker":
        assert self._reply() == "open"
        return self

    def ask(self, do: str, **values: Any) -> Reply:
        self._commands.write(json.dumps({"do": do, **values}) + "\n")
        self._commands.flush()
        return self._reply()

    def start(self, key: str = "", **config: Any) -> str:
        return str(self.ask("start", config=config, key=key)["id"])

    def watch(self, run_id: str, *, start: int = 0, until_step: int = 1000) -> Reply:
        """Returns a run's events up to one of a step, or its end."""
        return self.ask("watch", id=run_id, start=start, until_step=until_step)

    def pids(self, run_id: str) -> list[int]:
        return [int(pid) for pid in (self.runs / run_id / "pids.txt").read_text().split()]

    def steps(self, run_id: str) -> list[int]:
        return [int(step) for step in (self.runs / run_id / "steps.txt").read_text().split()]

    def child(self, run_id: str) -> psutil.Process:
        return psutil.Process(self.pids(run_id)[-1])

    def child_of_attempt(self, run_id: str, count: int) -> psutil.Process:
        """Waits for the child of a run's n-th attempt, counted from 1."""
        started = self.runs / run_id / "pids.txt"
        limit = time.monotonic() + 300
        while not started.is_file() or len(self.pids(run_id)) < count:
            assert time.monotonic() < limit
            time.sleep(0.01)
        return self.child(run_id)

    @property
    def is_closed(self) -> bool:
        return self._replies.closed

    def worker(self, run_id: str) -> str:
        """Returns the name of the worker of a run's last attempt."""
        return (self.runs / run_id / "worker.txt").read_text()

    def end(self, number: signal.Signals) -> int:
        self.process.send_signal(number)
        return self.process.wait(60)

    def close(self) -> str:
        """Kills it, unless it has ended; returns what it still said."""
        self.end(signal.SIGKILL)
        self._commands.close()
        with self._replies:
            return self._replies.read()

    def _reply(self) -> Reply:
        return json.loads(self._replies.readline())


@pytest.fixture
def new_worker(tmp_path: Path, fork_child: StartChild) -> Iterator[Callable[..., Worker]]:
    """A function that starts a worker, which may not open."""
    workers: list[Worker] = []

    def start(name: str = "worker", url: str = "") -> Worker:
        workers.append(Worker(fork_child, tmp_path, name, url))
        return workers[-1]

    yield start
    for worker in workers:
        if not worker.is_closed:
            worker.close()


@pytest.fixture
def begin(new_worker: Callable[..., Worker]) -> Callable[..., Worker]:
    """A function that starts a worker, and returns it when it is open."""
    return lambda name="worker", url="": new_worker(name, url).opened()


class Postgres:
    """A Postgres of our own, with its data in a folder of its own."""

    def __init__(self, folder: Path, port: int) -> None:
        self._port = port
        self.url = f"postgresql://test@127.0.0.1:{self._port}/postgres"
        self._data, self._folder = str(folder / "data"), str(folder)
        self._user: dict[str, Any] = {"user": "postgres"} if os.getuid() == 0 else {}  # it refuses to run as root
        if self._user:
            shutil.chown(folder, "postgres")
        make = ["initdb", "--no-sync", "--auth=trust", "--username=test", "-D", self._data]
        subprocess.run(make, check=True, stdout=subprocess.DEVNULL, **self._user)

    def start(self) -> None:
        serve = ["postgres", "-D", self._data, "-k", self._folder, "-p", str(self._port), "-c", "fsync=off"]
        self._server = subprocess.Popen(serve, stderr=subprocess.PIPE, text=True, **self._user)
        next(line for line in self._server.stderr or () if "ready to accept connections" in line)

    def stop(self) -> None:
        self._server.send_signal(signal.SIGQUIT)
        self._server.communicate()

    def freeze(self) -> None:
        """Keeps every connection open and answers nothing any more."""
        self._frozen = [psutil.Process(self._server.pid), *psutil.Process(self._server.pid).children()]
        for process in self._frozen:
            process.suspend()

    def thaw(self) -> None:
        for process in self._frozen:
            process.resume()


@pytest.fixture(scope="module")
def postgres(reserve_ports: Any) -> Iterator[Postgres]:
    if shutil.which("initdb") is None or shutil.which("postgres") is None:
        pytest.skip("needs a local Postgres")
    folder = Path(tempfile.mkdtemp(prefix="pg"))  # not `tmp_path`: the path of a socket is at most 107 bytes
    server = Postgres(folder, reserve_ports(["postgres"])["postgres"].rest)
    server.start()
    yield server
    server.stop()
    shutil.rmtree(folder)


def test_a_run_is_queued_runs_and_succeeds_and_a_watcher_may_come_back_for_the_rest(begin):
    worker = begin()
    run_id = worker.start()
    events = worker.watch(run_id)
    assert [event["sequence"] for event in events] == list(range(len(events)))
    assert [event["state"] for event in events][:2] == ["queued", "running"]
    assert events[-1] == {
        "sequence": len(events) - 1,
        "id": run_id,
        "kind": "ppo",
        "state": "succeeded",
        "config": {"steps": 5},
        "step": 5,
        "steps": 5,
        "metrics": {"loss": 0.2},  # without what was not finite
        "model": None,
        "error": "",
        "truth": "",
        "time_ns": events[-1]["time_ns"],
    }
    assert [event["time_ns"] for event in events] == sorted(event["time_ns"] for event in events)
    assert worker.watch(run_id, start=2) == events[2:]
    assert (worker.runs / run_id / "artifacts" / "count.txt").read_text() == "5"
    assert [run["id"] for run in worker.ask("list")] == [run_id]
    assert worker.ask("get", id="0" * 32) == {"error": "NotFound"}


@pytest.mark.fault("O1")
def test_a_killed_orchestrator_goes_on_with_its_run_where_the_checkpoint_is(begin):
    worker = begin()
    run_id = worker.start(wait_at=3)
    worker.watch(run_id, until_step=3)
    child = worker.child(run_id)
    worker.end(signal.SIGKILL)
    child.wait(60)  # nobody outlives the orchestrator

    after = begin()
    assert after.watch(run_id)[-1]["state"] == "succeeded"
    assert after.steps(run_id) == [1, 2, 3, 4, 5]
    assert len(after.pids(run_id)) == 2


@pytest.mark.fault("O1")
def test_an_orchestrator_killed_right_after_it_acknowledged_a_run_makes_it(begin):
    worker = begin()
    run_id = worker.start(key="once")
    worker.end(signal.SIGKILL)
    after = begin()
    assert after.start(key="once") == run_id
    assert after.watch(run_id)[-1]["state"] == "succeeded"


def test_three_failures_without_progress_end_a_run_with_a_diagnosis_and_it_can_be_resumed(begin):
    worker = begin()
    run_id = worker.start(crash=True)
    end = worker.watch(run_id)[-1]
    assert end["state"] == "failed"
    reason = "3 attempts in a row ended without progress. The child process was killed by SIGABRT"
    assert end["error"].startswith(reason)
    assert len(worker.pids(run_id)) == 1 + 3  # the first got further than none before it
    assert worker.ask("resume", id=run_id)["state"] in ("queued", "running")
    assert worker.watch(run_id, start=end["sequence"] + 1)[-1]["state"] == "failed"
    assert len(worker.pids(run_id)) == 1 + 3 + 3


@pytest.mark.fault("F8")
def test_a_run_that_is_killed_before_its_first_progress_waits_and_goes_on_and_shows_why(begin):
    worker = begin()
    run_id = worker.start(killed=3)
    for count, number in enumerate((signal.SIGKILL, signal.SIGTERM, signal.SIGKILL), start=1):
        worker.child_of_attempt(run_id, count).send_signal(number)
    events = worker.watch(run_id)
    assert events[-1]["state"] == "succeeded"
    waits = [(event["state"], event["error"]) for event in events if event["error"]]
    killed = "The child process was killed by {}. The next attempt begins after {} s."
    out_of_memory = "SIGKILL, or memory ran out"
    names = ((out_of_memory, "0.5"), ("SIGTERM", "1"), (out_of_memory, "2"))
    assert waits == [("running", killed.format(*each)) for each in names]


def test_what_cannot_succeed_is_tried_once_and_says_why(begin):
    worker = begin()
    run_id = worker.start(complaint="The dataset must hold two skills; it holds one.")
    assert worker.watch(run_id)[-1]["error"] == "The dataset must hold two skills; it holds one."
    assert len(worker.pids(run_id)) == 1


@pytest.mark.fault("O10")
def test_a_run_is_soon_cancelled_saves_and_can_be_resumed(begin):
    worker = begin()
    run_id = worker.start(wait_at=3)
    worker.watch(run_id, until_step=3)
    child, began = worker.child(run_id), time.monotonic()
    assert worker.ask("cancel", id=run_id)["state"] == "cancelled"
    child.wait(60)
    assert time.monotonic() - began < 20
    assert (worker.runs / run_id / "saved.txt").read_text() == "yes"
    assert (worker.runs / run_id / CANCELLED_FILE).exists()
    assert worker.watch(run_id)[-1]["state"] == "cancelled"

    worker.ask("resume", id=run_id)
    assert worker.watch(run_id)[-1]["state"] == "succeeded"
    assert worker.steps(run_id) == [1, 2, 3, 4, 5]
    assert worker.ask("resume", id=run_id) == {"error": "FailedPrecondition"}


@pytest.mark.fault("O2")
def test_runs_are_made_one_at_a_time_and_go_on_when_their_child_is_killed_and_a_queued_one_can_be_cancelled(begin):
    worker = begin()
    first, second = worker.start(wait_at=1), worker.start()
    worker.watch(first, until_step=1)
    assert worker.ask("get", id=second)["state"] == "queued"
    assert worker.ask("cancel", id=second)["state"] == "cancelled"
    worker.child(first).kill()
    assert worker.watch(first)[-1]["state"] == "succeeded"
    assert worker.steps(first) == [1, 2, 3, 4, 5]
    assert not (worker.runs / second / "pids.txt").exists()


@pytest.mark.fault("O15")
def test_a_worker_told_to_end_lets_the_child_save_and_the_next_goes_on(begin):
    worker = begin()
    run_id = worker.start(wait_at=3)
    worker.watch(run_id, until_step=3)
    assert worker.end(signal.SIGTERM) == 0
    assert (worker.runs / run_id / "saved.txt").read_text() == "yes"
    assert not (worker.runs / run_id / CANCELLED_FILE).exists()
    assert begin().watch(run_id)[-1]["state"] == "succeeded"


@pytest.mark.fault("O5")
def test_a_run_goes_on_when_there_is_room_again_for_what_its_attempt_came_to(begin, tmp_path, wait_until):
    worker = begin()
    run_id = worker.start(wait_at=3)
    worker.watch(run_id, until_step=3)
    process, whole = psutil.Process(worker.process.pid), (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    process.rlimit(resource.RLIMIT_FSIZE, (32_768, resource.RLIM_INFINITY))  # enough for the log, not for the database
    worker.child(run_id).kill()
    wait_until(lambda: "cannot be recorded" in (tmp_path / "worker.log").read_text(), 300)
    assert worker.process.poll() is None
    process.rlimit(resource.RLIMIT_FSIZE, whole)
    assert worker.watch(run_id)[-1]["state"] == "succeeded"
    assert worker.steps(run_id) == [1, 2, 3, 4, 5]


@pytest.mark.fault("O6")
def test_a_second_worker_of_the_same_name_is_refused(begin, new_worker):
    begin()
    second = new_worker()
    assert second.process.wait(300) == 3
    assert second.close() == ""


@pytest.mark.fault("O6")
def test_another_worker_takes_over_from_one_that_is_gone_at_last(begin, tmp_path, wait_until):
    one = begin("one")
    run_id = one.start(wait_at=3)
    one.watch(run_id, until_step=3)
    other = begin("other")
    assert one.child(run_id).is_running()
    lock = one.runs / run_id / "state.lock"
    lock.unlink(missing_ok=True)
    lock.mkdir()  # so that it cannot be opened
    one.end(signal.SIGKILL)
    wait_until(lambda: "was not taken over" in (tmp_path / "other.log").read_text(), 300)
    lock.rmdir()
    assert other.watch(run_id)[-1]["state"] == "succeeded"
    assert other.steps(run_id) == [1, 2, 3, 4, 5]


def test_the_database_holds_json_and_no_pickle_and_nobody_is_called(begin):
    worker = begin()
    failed, run_id = worker.start(complaint="No."), worker.start()
    worker.watch(failed)
    worker.watch(run_id)
    assert psutil.Process(worker.process.pid).net_connections("inet") == []
    worker.end(signal.SIGTERM)
    with contextlib.closing(sqlite3.connect(worker.runs / "runs.sqlite")) as database:
        rows = database.execute("SELECT serialization, output FROM operation_outputs").fetchall()
        inputs = database.execute("SELECT serialization FROM workflow_status").fetchall()
    assert {row[0] for row in rows + inputs} == {"portable_json"}
    assert all(json.loads(output) is None or json.loads(output)["outcome"] for _, output in rows)
    assert b"gAS" not in (worker.runs / "runs.sqlite").read_bytes()  # how a pickle begins in base64


@pytest.mark.fault("O6")
def test_two_workers_on_one_postgres_share_the_queue_and_take_over_from_each_other(begin, postgres):
    one, two = begin("one", postgres.url), begin("two", postgres.url)
    waiting = [one.start(wait_at=1), one.start(wait_at=1)]
    for run_id in waiting:
        one.watch(run_id, until_step=1)  # both at once, though each worker makes one at a time
    by_worker = {one.worker(run_id): run_id for run_id in waiting}
    of_one, of_two = by_worker["one"], by_worker["two"]
    child = one.child(of_two)
    assert one.ask("cancel", id=of_two)["state"] == "cancelled"  # though the other has its child
    child.wait(60)
    one.end(signal.SIGKILL)
    assert two.watch(of_one)[-1]["state"] == "succeeded"
    assert two.steps(of_one) == [1, 2, 3, 4, 5]


@pytest.mark.fault("O6")
def test_a_second_worker_of_the_same_name_on_one_postgres_is_refused(begin, new_worker, postgres):
    begin("three", postgres.url)
    second = new_worker("three", postgres.url)
    assert second.process.wait(300) == 3
    assert second.close() == ""


@pytest.mark.fault("F12")
def test_a_postgres_of_another_encoding_ends_the_start_with_one_line_that_says_so(tmp_path, postgres, run_badly):
    with psycopg.connect(postgres.url, autocommit=True) as connection:
        connection.execute("CREATE DATABASE ascii ENCODING 'SQL_ASCII' LOCALE 'C' TEMPLATE template0")
    url = postgres.url.replace("/postgres", "/ascii")
    code, stderr = run_badly("freerein_orchestrator", tmp_path, FREEREIN_DATABASE_URL=url)
    assert code == 3
    (line,) = (line for line in stderr.splitlines() if not line.startswith("{"))
    assert line.startswith("cannot start: ")
    assert "must have the encoding UTF8; it has SQL_ASCII" in line
    assert "CREATE DATABASE" in line


def test_a_run_goes_on_while_its_database_is_away(begin, postgres):
    worker = begin("four", postgres.url)
    run_id = worker.start(wait_at=3)
    worker.watch(run_id, until_step=3)
    postgres.stop()
    assert worker.ask("cancel", id=run_id) == {"error": "Unavailable"}
    assert worker.child(run_id).is_running()
    postgres.start()
    worker.child(run_id).kill()
    assert worker.watch(run_id)[-1]["state"] == "succeeded"


def test_a_database_that_has_frozen_is_unavailable_and_a_worker_can_end_without_it(begin, postgres):
    worker = begin("five", postgres.url)
    run_id = worker.start(wait_at=3)
    worker.watch(run_id, until_step=3)
    postgres.freeze()
    try:
        assert worker.ask("cancel", id=run_id) == {"error": "Unavailable"}
        assert worker.child(run_id).is_running()
        assert worker.end(signal.SIGTERM) == 0
        assert (worker.runs / run_id / "saved.txt").read_text() == "yes"
    finally:
        postgres.thaw()
    after = begin("five", postgres.url)
    assert after.watch(run_id)[-1]["state"] in ("cancelled", "succeeded")  # what was refused may still have arrived
