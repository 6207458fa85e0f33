"""The durable queue of runs: each run is a DBOS workflow in a database. The only file that imports DBOS.

A workflow makes attempts until one ends the run. An attempt is one step: a step per poll of the child process would
make the database, and the replay after a crash, as long as the run. An attempt whose worker dies is made again.

A workflow waits for an unreachable database as long as it takes; a query about runs is refused within seconds.
"""

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import psycopg
from dbos import DBOS, DBOSClient, DBOSConfig, DBOSPortableJSONSerializer, WorkflowStatus
from sqlalchemy import make_url
from sqlalchemy.exc import DBAPIError

from freerein.errors import FailedPrecondition, NotFound, ServiceError
from freerein.jobs.attempt import INTERNAL_ERROR, AttemptStopped, StopRequest
from freerein.jobs.retry import AttemptResult, Pause, retry
from freerein.jobs.store import JobStore
from freerein.types.jobs import JobState
from freerein_orchestrator.runs.database_errors import database_error, unreachable
from freerein_orchestrator.runs.worker_locks import FileLocks, PostgresLocks

_log = logging.getLogger(__name__)
_APPLICATION = "freerein-orchestrator"
_VERSION = "1"  # constant: DBOS ignores workflows of other versions, and its default is a hash of the code
_QUEUE = "runs"
_WORKFLOW = "run"
_POLL_S = 0.2
_QUEUE_POLL_S = 0.5  # a poll costs milliseconds of a core
_STOP_S = 7.0
_DATABASE_S = 30.0
_QUERIES = 4  # at a time
_POSTGRES_TIMEOUTS = {  # in seconds; the last in milliseconds
    "connect_timeout": "5",
    "keepalives_idle": "5",
    "keepalives_interval": "5",
    "keepalives_count": "2",
    "tcp_user_timeout": "10000",
}

T = TypeVar("T")

_STATES: dict[str, JobState] = {
    "ENQUEUED": "queued",
    "DELAYED": "queued",
    "PENDING": "running",
    "CANCELLED": "cancelled",
    "ERROR": "failed",
    "MAX_RECOVERY_ATTEMPTS_EXCEEDED": "failed",
}


@dataclass(frozen=True)
class RunStatus:
    """A run as the database has it.

    Attributes:
        state: Its state.
        error: Reason of a failure, else empty.
    """

    state: JobState
    error: str = ""


class DbosQueue:
    """The queue of runs of one database, and one worker that executes them one at a time.

    One per process: DBOS allows no more. Its methods block, and belong on threads without an event loop.

    Args:
        folder: Folder of the SQLite database and of the worker locks.
        store: The runs on disk.
        attempt: Makes an attempt at a run, given its id, a function that tells it to stop, and the pause before it; see
            `AttemptRunner.run`.
        database_url: URL of Postgres, `postgresql://...`; empty for SQLite.
        executor_id: Name of the worker, the same at every start: a restarted worker resumes its runs at once.
        takeover_s: Interval between searches for runs of dead workers.
        answer_s: Seconds after which a query counts as unanswered.
    """

    def __init__(
        self,
        folder: Path,
        *,
        store: JobStore,
        attempt: Callable[[str, Callable[[], StopRequest], Pause], AttemptResult],
        database_url: str = "",
        executor_id: str,
        takeover_s: float = 5.0,
        answer_s: float = 10.0,
    ) -> None:
        self._folder = folder
        self._store = store
        self._attempt = attempt
        url = _with_timeouts(database_url) if database_url else ""
        self._url = url or f"sqlite:///{folder.absolute() / 'runs.sqlite'}"
        self._executor_id = executor_id
        self._takeover_s = takeover_s
        self._answer_s = answer_s
        self._locks = PostgresLocks(url) if url else FileLocks(folder)
        self._opening, self._opened = threading.Lock(), False
        self._closing = threading.Event()
        self._idle = threading.Condition()
        self._attempts = 0
        self._runs: set[str] = set()
        self._orphans: set[str] = set()
        self._sweeper = threading.Thread(target=self._sweep, name="takeover", daemon=True)
        self._client = DBOSClient(  # unlike DBOS itself, it does not wait for an unreachable database
            system_database_url=self._url,
            application_name=_APPLICATION,
            serializer=DBOSPortableJSONSerializer(),
            retry_connection_errors=False,
            lazy=True,
        )
        self._queries = ThreadPoolExecutor(_QUERIES, "database")
        logging.getLogger("dbos").addHandler(logging.NullHandler())  # without a handler, DBOS adds its own
        logging.getLogger("dbos").addFilter(_without_traceback)

    def open(self) -> None:
        """Opens the database, resumes the runs of this worker, and starts to execute queued ones.

        Raises:
            FailedPrecondition: A worker of this name is running, or the database has another encoding than UTF8.
            Unavailable: The database was out of reach for half a minute.
            OutOfStorage: The disk of the database is full, broken or read-only.
        """
        with self._opening:
            self._folder.mkdir(parents=True, exist_ok=True)
            if not self._take_own_lock():
                return
            config: DBOSConfig = {
                "name": _APPLICATION,
                "system_database_url": self._url,
                "application_version": _VERSION,
                "executor_id": self._executor_id,
                "serializer": DBOSPortableJSONSerializer(),
                "enable_otlp": False,
                "log_level": "WARNING",
                "sys_db_pool_size": 8,
            }
            DBOS(config=config)

            @DBOS.workflow(name=_WORKFLOW, max_recovery_attempts=None)
            def run(run_id: str) -> dict[str, Any]:
                return self._execute(run_id)

            try:
                DBOS.launch()
                DBOS.register_queue(
                    _QUEUE, worker_concurrency=1, polling_interval_sec=_QUEUE_POLL_S, on_conflict="always_update"
                )
            except DBAPIError as refused:
                DBOS.destroy(destroy_registry=True)
                raise database_error(refused) from refused
            self._sweeper.start()
            self._opened = True

    def close(self) -> None:
        """Interrupts the attempt in progress and waits for it; the next start resumes its run.

        Threads that wait for an unreachable database are left behind after some seconds.
        """
        self._closing.set()
        closing = threading.Thread(target=self._close, name="close", daemon=True)
        closing.start()
        closing.join(_STOP_S)

    def start(self, run_id: str) -> None:
        """Queues a run, unless it is known already."""
        self._query(
            lambda: self._client.enqueue(
                {"workflow_name": _WORKFLOW, "queue_name": _QUEUE, "workflow_id": run_id, "app_version": _VERSION},
                run_id,
            )
        )

    def status(self, run_id: str) -> RunStatus:
        """Returns the status of a run. Raises NotFound when there is no such run."""
        return _run_status(self._query(lambda: self._workflow(run_id)))

    def states(self, run_ids: Sequence[str]) -> dict[str, JobState]:
        """Returns the states of those runs that the database knows, by id."""
        found = self._query(lambda: self._workflows(workflow_ids=list(run_ids))) if run_ids else []
        return {workflow.workflow_id: _run_status(workflow).state for workflow in found}

    def count_queued(self, *, limit: int) -> int:
        """Returns the number of queued runs, at most `limit`."""
        queued = [name for name, state in _STATES.items() if state == "queued"]
        return len(self._query(lambda: self._workflows(status=queued, limit=limit)))

    def cancel(self, run_id: str) -> None:
        """Cancels a run, unless it has ended; its worker, whichever that is, stops the attempt soon after."""
        self._query(lambda: self._client.cancel_workflow(run_id))

    def delete(self, run_id: str) -> None:
        """Forgets an ended run; without an effect where it is not known."""
        self._query(lambda: self._client.delete_workflow(run_id))

    def resume(self, run_id: str) -> None:
        """Queues an ended run again; past failures no longer count."""
        self._query(lambda: self._client.rewind_workflow(run_id, queue_name=_QUEUE))

    def _query(self, query: Callable[[], T]) -> T:
        """Returns the answer of the database.

        Raises:
            Unavailable: The database is out of reach, or frozen, which no socket tells.
            OutOfStorage: Its disk is full, broken or read-only.
        """
        answer = self._queries.submit(query)
        try:
            return answer.result(self._answer_s)
        except (DBAPIError, TimeoutError) as away:
            answer.cancel()
            raise database_error(away) from away

    def _execute(self, run_id: str) -> dict[str, Any]:
        """The workflow: makes attempts until the run ends; returns its status."""
        self._runs.add(run_id)
        try:
            result = retry(
                lambda pause: AttemptResult(**DBOS.run_step({"name": "attempt"}, self._make_attempt, run_id, pause))
            )
            state: JobState = "succeeded" if result.outcome == "succeeded" else "failed"
            DBOS.run_step({"name": "record_end"}, self._record, run_id, state, result.error)
            return asdict(RunStatus(state, result.error))
        except DBAPIError as refused:  # a full disk, with the database on it: the sweeper has the attempt made again
            _log.warning("the result of an attempt cannot be recorded", extra={"run": run_id})
            raise AttemptStopped from refused
        finally:
            self._runs.discard(run_id)

    def _record(self, run_id: str, state: JobState, error: str) -> None:
        try:
            self._store.record(run_id, state, error=error)
        except (OSError, NotFound):  # a full disk, or no such run here; recorded when the run is next read
            _log.warning("the state of a run cannot be recorded", extra={"run": run_id})

    def _make_attempt(self, run_id: str, pause: Pause) -> dict[str, Any]:
        with self._idle:
            if self._closing.is_set():
                raise AttemptStopped
            self._attempts += 1
        try:
            if self._store.exists(run_id) and self._store.last(run_id).ended:
                self._record(run_id, "queued", "")  # ResumeRun gave up on the database too soon to record it
            return asdict(self._attempt(run_id, self._stop_request(run_id), pause))
        except Exception:  # a bug must not leave the run without an end
            _log.exception("an attempt failed", extra={"run": run_id})
            return asdict(AttemptResult("failed", error=INTERNAL_ERROR))
        finally:
            with self._idle:
                self._attempts -= 1
                self._idle.notify_all()

    def _stop_request(self, run_id: str) -> Callable[[], StopRequest]:
        """Returns a function that tells an attempt to stop: this worker closes, or the run is cancelled or taken over.

        It never waits for the database; without it the attempt continues.
        """
        query: Future[WorkflowStatus] | None = None

        def request() -> StopRequest:
            nonlocal query
            if self._closing.is_set():
                return "interrupt"
            try:
                query = query or self._queries.submit(self._workflow, run_id)
                workflow = query.result(_POLL_S)
            except TimeoutError:
                return ""
            except DBAPIError:
                query = None
                return ""
            query = None
            if workflow.status == "CANCELLED":
                return "cancel"
            is_ours = workflow.status == "PENDING" and workflow.executor_id == self._executor_id
            return "" if is_ours else "interrupt"

        return request

    def _workflows(self, **filters: Any) -> list[WorkflowStatus]:
        return self._client.list_workflows(name=_WORKFLOW, load_input=False, **filters)

    def _workflow(self, run_id: str) -> WorkflowStatus:
        found = self._workflows(workflow_ids=[run_id])
        if not found:
            raise NotFound("There is no run of this id.", field="id", hint="GET /v1/list-runs lists them.")
        return found[0]

    def _take_own_lock(self) -> bool:
        """Takes the lock of this worker, once a predecessor has ended; returns False when closed meanwhile."""
        began = time.monotonic()
        while not self._closing.is_set():
            refusal: ServiceError = FailedPrecondition(
                f"The name of a worker must be unique; a worker named {self._executor_id} is running.",
                field="executor_id",
                hint="Stop it, or set FREEREIN_EXECUTOR_ID to another name.",
            )
            timeout_s = self._locks.predecessor_s
            try:
                if self._locks.take(self._executor_id):
                    return True
            except psycopg.OperationalError:
                refusal, timeout_s = unreachable(), _DATABASE_S
            if time.monotonic() - began > timeout_s:
                raise refusal
            self._closing.wait(_POLL_S)
        return False

    def _sweep(self) -> None:
        """Takes over the runs of dead workers, and resumes its own whose results the database could not record."""
        while not self._closing.wait(self._takeover_s):
            try:
                if self._locks.take(self._executor_id):  # again, if the database was out of reach meanwhile
                    self._take_over()
            except (psycopg.OperationalError, DBAPIError):
                _log.warning("the database of the runs is out of reach")

    def _take_over(self) -> None:
        running = self._workflows(status="PENDING")
        for worker in {status.executor_id for status in running}:
            if worker and worker != self._executor_id and self._locks.take(worker):
                try:
                    self._requeue(worker)
                finally:
                    self._locks.free(worker)
        orphans = {status.workflow_id for status in running if status.executor_id == self._executor_id} - self._runs
        if orphans & self._orphans and not self._runs:
            self._requeue(self._executor_id)
        self._orphans = orphans

    def _requeue(self, worker: str) -> None:
        """Queues again the runs that a worker has begun and does not execute, but for those that are cancelled."""
        for run_id in [each.workflow_id for each in self._workflows(status="PENDING", executor_id=worker)]:
            try:
                with self._store.lock(run_id) if self._store.exists(run_id) else nullcontext():  # nobody cancels now
                    workflow = self._workflow(run_id)
                    if (workflow.status, workflow.executor_id) == ("PENDING", worker):
                        self._client.resume_workflow(run_id, queue_name=_QUEUE)
            except (OSError, ServiceError) as error:  # a full disk, or it was deleted: the next sweep tries again
                _log.warning("run %s was not taken over: %s", run_id, error)

    def _close(self) -> None:
        with self._opening:
            if self._opened:
                with self._idle:
                    self._idle.wait_for(lambda: self._attempts == 0)
                self._sweeper.join()
                DBOS.destroy(destroy_registry=True)
            self._queries.shutdown(wait=False, cancel_futures=True)
            self._client.destroy()
            self._locks.close()


def _with_timeouts(url: str) -> str:
    """Returns a Postgres URL with timeouts for a dead host, where it sets none."""
    parsed = make_url(url)
    return parsed.set(query={**_POSTGRES_TIMEOUTS, **parsed.query}).render_as_string(hide_password=False)


def _without_traceback(record: logging.LogRecord) -> bool:
    """Keeps the reason alone of what DBOS logs about a database that refuses: it is no bug, and tried again."""
    if record.exc_info and isinstance(record.exc_info[1], DBAPIError):
        record.msg, record.exc_info = f"{record.msg} {record.exc_info[1].orig}", None
    return True


def _run_status(workflow: WorkflowStatus) -> RunStatus:
    if workflow.status == "SUCCESS":
        status: Mapping[str, Any] = workflow.output  # type: ignore[assignment]  # what `_execute` returned
        return RunStatus(status["state"], status.get("error", ""))
    state = _STATES[workflow.status]
    return RunStatus(state, INTERNAL_ERROR if state == "failed" else "")
