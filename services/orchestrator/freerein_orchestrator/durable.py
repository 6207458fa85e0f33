"""Runs that outlive their process: each is a DBOS workflow in a database, and this is the only file that knows DBOS.

A run is a sequence of attempts until one ends it. An attempt is one step of the workflow, for it is what one child
process does: it has no result until that child has ended, and a step for every look at the child would make the
database, and the replay after a crash, as long as the run. An attempt whose process dies under it is made again.

A workflow waits for a database that is away, for as long as it takes; a question about runs is refused within seconds.
"""

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import psycopg
from dbos import DBOS, DBOSClient, DBOSConfig, DBOSPortableJSONSerializer, WorkflowStatus
from sqlalchemy import make_url
from sqlalchemy.exc import DBAPIError

from freerein.errors import FailedPrecondition, NotFound, ServiceError, Unavailable
from freerein.types.orchestrator import RunState
from freerein_orchestrator.outcomes import A_BUG, Attempt, Interrupted, Reason, Standing
from freerein_orchestrator.worker_locks import FileLocks, PostgresLocks, WorkerLocks

_log = logging.getLogger(__name__)
_APPLICATION = "freerein-orchestrator"
_VERSION = "1"  # a constant: DBOS leaves alone what another version began, and its own default is a hash of the code
_QUEUE = "runs"
_WORKFLOW = "run"
_POLL_S = 0.2
_QUEUE_POLL_S = 0.5  # each look costs milliseconds of a core
_STOP_S = 7.0
_PREDECESSOR_S = 2.0
_DATABASE_S = 30.0
_ANSWER_S = 10.0
_QUESTIONS = 4  # at a time
_CRASHES = 3
_NOTICE_A_DEAD_HOST = {  # seconds, but for the last: milliseconds
    "connect_timeout": "5",
    "keepalives_idle": "5",
    "keepalives_interval": "5",
    "keepalives_count": "2",
    "tcp_user_timeout": "10000",
}

T = TypeVar("T")

_STATES: dict[str, RunState] = {
    "ENQUEUED": "queued",
    "DELAYED": "queued",
    "PENDING": "running",
    "CANCELLED": "cancelled",
    "ERROR": "failed",
    "MAX_RECOVERY_ATTEMPTS_EXCEEDED": "failed",
}


MakeAttempt = Callable[[str, Callable[[], Reason]], Attempt]
"""Makes an attempt at the run of an id; raises Interrupted soon after the second argument has returned a reason to."""
NoteEnd = Callable[[str, RunState, str], None]
"""Notes a run's id, how it ended, and why it failed; perhaps twice."""


class DurableRuns:
    """The runs of one database, and one worker that makes attempts at them, one run at a time.

    One per process: DBOS allows no more. Its methods block, and belong on threads without an event loop.

    Args:
        folder: Where the SQLite database and the locks of the workers lie.
        database_url: Of Postgres, `postgresql://...`; empty for SQLite.
        executor_id: The worker's name, the same at every start: a restarted worker goes on with its runs at once.
        attempt: Makes an attempt.
        note_end: Is told the end of each run.
        takeover_s: How often it looks for runs of workers that are gone.
    """

    def __init__(
        self,
        folder: Path,
        *,
        database_url: str = "",
        executor_id: str,
        attempt: MakeAttempt,
        note_end: NoteEnd,
        takeover_s: float = 5.0,
    ) -> None:
        self._folder = folder
        url = _impatient(database_url) if database_url else ""
        self._url = url or f"sqlite:///{folder.absolute() / 'runs.sqlite'}"
        self._executor_id = executor_id
        self._attempt = attempt
        self._note_end = note_end
        self._takeover_s = takeover_s
        self._locks: WorkerLocks = PostgresLocks(url) if url else FileLocks(folder)
        self._opening, self._opened = threading.Lock(), False
        self._closing = threading.Event()
        self._idle = threading.Condition()
        self._attempts = 0
        self._runs: set[str] = set()
        self._orphans: set[str] = set()
        self._sweeper = threading.Thread(target=self._sweep, name="takeover", daemon=True)
        self._client = self._connect()
        self._questions = ThreadPoolExecutor(_QUESTIONS, "database")

    def open(self) -> None:
        """Opens the database, goes on with this worker's runs, and begins to take queued ones.

        Raises:
            FailedPrecondition: A worker of this name is running.
            Unavailable: The database could not be reached for half a minute.
        """
        with self._opening:
            self._folder.mkdir(parents=True, exist_ok=True)
            if not self._take_own_lock():
                return
            logging.getLogger("dbos").addHandler(logging.NullHandler())  # else DBOS logs past our log
            DBOS(config=self._config())

            @DBOS.workflow(name=_WORKFLOW, max_recovery_attempts=None)
            def run(run_id: str) -> dict[str, Any]:
                return self._try_to_run(run_id)

            DBOS.launch()
            DBOS.register_queue(
                _QUEUE, worker_concurrency=1, polling_interval_sec=_QUEUE_POLL_S, on_conflict="always_update"
            )
            self._sweeper.start()
            self._opened = True

    def close(self) -> None:
        """Interrupts the attempt being made, and waits for it; the next start goes on with its run.

        Threads that wait for a database that is away are left behind after some seconds.
        """
        self._closing.set()
        closing = threading.Thread(target=self._close, name="close", daemon=True)
        closing.start()
        closing.join(_STOP_S)

    def start(self, run_id: str) -> None:
        """Queues a run; one that there is already stays as it is."""
        self._ask(
            lambda: self._client.enqueue(
                {"workflow_name": _WORKFLOW, "queue_name": _QUEUE, "workflow_id": run_id, "app_version": _VERSION},
                run_id,
            )
        )

    def standing(self, run_id: str) -> Standing:
        """Returns where a run stands.

        Raises:
            NotFound: There is none of that id.
        """
        return _standing(self._ask(lambda: self._status(run_id)))

    def states(self) -> dict[str, RunState]:
        """Returns where every run stands, by id, newest first."""
        found = self._ask(lambda: self._client.list_workflows(name=_WORKFLOW, sort_desc=True, load_input=False))
        return {status.workflow_id: _standing(status).state for status in found}

    def count_queued(self, *, limit: int) -> int:
        """Returns how many runs are queued, at most `limit`."""
        queued = [name for name, state in _STATES.items() if state == "queued"]
        found = self._ask(
            lambda: self._client.list_workflows(
                name=_WORKFLOW, status=queued, limit=limit, load_input=False, load_output=False
            )
        )
        return len(found)

    def cancel(self, run_id: str) -> None:
        """Ends a run, unless it has ended; its worker, whichever that is, stops its attempt soon after."""
        self._ask(lambda: self._client.cancel_workflow(run_id))

    def resume(self, run_id: str) -> None:
        """Queues a run again that has ended; past failures no longer count."""
        self._ask(lambda: self._client.rewind_workflow(run_id, queue_name=_QUEUE))

    def _ask(self, question: Callable[[], T]) -> T:
        """Returns the database's answer.

        Raises:
            Unavailable: There is none: the database is away, or has frozen, which no socket tells.
        """
        answer = self._questions.submit(question)
        try:
            return answer.result(_ANSWER_S)
        except (DBAPIError, TimeoutError) as away:
            answer.cancel()
            raise _unreachable() from away

    def _try_to_run(self, run_id: str) -> dict[str, Any]:
        self._runs.add(run_id)
        try:
            return self._run(run_id)
        except DBAPIError as refused:  # a full disk, with the database on it; the sweeper has the run made again
            _log.warning("what an attempt came to cannot be recorded", extra={"run": run_id})
            raise Interrupted from refused
        finally:
            self._runs.discard(run_id)

    def _run(self, run_id: str) -> dict[str, Any]:
        """The workflow: attempts until one ends the run, or three in a row got no further."""
        crashes = 0
        while True:
            attempt = Attempt(**DBOS.run_step({"name": "attempt"}, self._make_attempt, run_id))
            crashes = 0 if attempt.progressed else crashes + 1
            if attempt.outcome != "crashed":
                return self._end(run_id, attempt.outcome, attempt.reason)
            if crashes >= _CRASHES:
                return self._end(
                    run_id, "failed", f"{crashes} attempts in a row ended without progress. {attempt.reason}"
                )

    def _end(self, run_id: str, state: RunState, reason: str) -> dict[str, Any]:
        DBOS.run_step({"name": "note_end"}, self._try_to_note_end, run_id, state, reason)
        return {"state": state, "reason": reason}

    def _try_to_note_end(self, run_id: str, state: RunState, reason: str) -> None:
        try:
            self._note_end(run_id, state, reason)
        except OSError:  # a full disk changes no outcome; whoever looks at the run notes its end
            _log.warning("the end of a run cannot be noted", extra={"run": run_id})

    def _make_attempt(self, run_id: str) -> dict[str, Any]:
        with self._idle:
            if self._closing.is_set():
                raise Interrupted
            self._attempts += 1
        try:
            return asdict(self._attempt(run_id, self._told_to_stop(run_id)))
        except Exception:  # one run's bug must not leave it without an end
            _log.exception("an attempt failed", extra={"run": run_id})
            return asdict(Attempt("failed", reason=A_BUG))
        finally:
            with self._idle:
                self._attempts -= 1
                self._idle.notify_all()

    def _told_to_stop(self, run_id: str) -> Callable[[], Reason]:
        """Returns what says whether this worker is closing, or the run is no longer its own: cancelled, or taken over.

        It never waits for the database, without which goes on what has begun.
        """
        asked: Future[WorkflowStatus] | None = None

        def told() -> Reason:
            nonlocal asked
            if self._closing.is_set():
                return "leave"
            try:
                asked = asked or self._questions.submit(self._status, run_id)
                status = asked.result(_POLL_S)
            except TimeoutError:
                return ""
            except DBAPIError:
                asked = None
                return ""
            asked = None
            if status.status == "CANCELLED":
                return "cancel"
            return "leave" if status.status != "PENDING" or status.executor_id != self._executor_id else ""

        return told

    def _status(self, run_id: str) -> WorkflowStatus:
        found = self._client.list_workflows(workflow_ids=[run_id], load_input=False)
        if not found:
            raise NotFound("There is no run of this id.", field="id", hint="GET /v1/list-runs names them.")
        return found[0]

    def _take_own_lock(self) -> bool:
        """Takes this worker's lock, once a predecessor has ended; returns False when told to close meanwhile."""
        began = time.monotonic()
        while not self._closing.is_set():
            refusal: ServiceError = FailedPrecondition(
                f"A worker's name must be its own; one called {self._executor_id} is running.",
                field="executor_id",
                hint="Stop it, or set FREEREIN_EXECUTOR_ID to another name.",
            )
            patience_s = _PREDECESSOR_S
            try:
                if self._locks.take(self._executor_id):
                    return True
            except psycopg.OperationalError:
                refusal, patience_s = _unreachable(), _DATABASE_S
            if time.monotonic() - began > patience_s:
                raise refusal
            self._closing.wait(_POLL_S)
        return False

    def _sweep(self) -> None:
        """Takes over the runs of workers that are gone, and goes on with its own that the database would not record."""
        while not self._closing.wait(self._takeover_s):
            try:
                if self._locks.take(self._executor_id):  # once more, if the database was away meanwhile
                    self._take_over()
            except (psycopg.OperationalError, DBAPIError):
                _log.warning("the database of the runs cannot be reached")

    def _take_over(self) -> None:
        running = self._client.list_workflows(name=_WORKFLOW, status="PENDING", load_input=False, load_output=False)
        for worker in {status.executor_id for status in running}:
            if worker and worker != self._executor_id and self._locks.take(worker):
                try:
                    DBOS._recover_pending_workflows([worker])  # DBOS has no public name for it
                finally:
                    self._locks.free(worker)
        orphans = {status.workflow_id for status in running if status.executor_id == self._executor_id} - self._runs
        if orphans & self._orphans and not self._runs:
            DBOS._recover_pending_workflows([self._executor_id])
        self._orphans = orphans

    def _close(self) -> None:
        with self._opening:
            if self._opened:
                with self._idle:
                    self._idle.wait_for(lambda: self._attempts == 0)
                self._sweeper.join()
                DBOS.destroy(destroy_registry=True)
            self._questions.shutdown(wait=False, cancel_futures=True)
            self._client.destroy()
            self._locks.close()

    def _connect(self) -> DBOSClient:
        """Returns what asks the database about runs, and unlike DBOS itself, does not wait for one that is away."""
        return DBOSClient(
            system_database_url=self._url,
            application_name=_APPLICATION,
            serializer=DBOSPortableJSONSerializer(),
            retry_connection_errors=False,
            lazy=True,
        )

    def _config(self) -> DBOSConfig:
        return {
            "name": _APPLICATION,
            "system_database_url": self._url,
            "application_version": _VERSION,
            "executor_id": self._executor_id,
            "serializer": DBOSPortableJSONSerializer(),
            "enable_otlp": False,
            "log_level": "WARNING",
            "sys_db_pool_size": 8,
        }


def _impatient(url: str) -> str:
    """Returns a Postgres URL with limits, where it names none, after which a host that has vanished is given up."""
    parsed = make_url(url)
    return parsed.set(query={**_NOTICE_A_DEAD_HOST, **parsed.query}).render_as_string(hide_password=False)


def _unreachable() -> Unavailable:
    return Unavailable(
        "The database of the runs must be within reach; it is not, or lets nobody in.",
        hint="Start it, create the database, or set FREEREIN_DATABASE_URL to another.",
        retry_after_s=1.0,
    )


def _standing(status: WorkflowStatus) -> Standing:
    if status.status == "SUCCESS":
        return Standing(**status.output)  # type: ignore[arg-type]  # what `_end` returned
    state = _STATES[status.status]
    return Standing(state, A_BUG if state == "failed" else "")
