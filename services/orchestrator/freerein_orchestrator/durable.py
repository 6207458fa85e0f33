"""Runs that outlive their process: each is a DBOS workflow in a database, and this is the only file that knows DBOS.

A run is a sequence of attempts until one ends it. An attempt is one step of the workflow, for it is what one child
process does: it has no result until that child has ended, and a step for every look at the child would make the
database, and the replay after a crash, as long as the run. An attempt whose process dies under it is made again.
"""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import psycopg
from dbos import DBOS, DBOSConfig, DBOSPortableJSONSerializer, SetWorkflowID, WorkflowStatus, error
from sqlalchemy.exc import DBAPIError

from freerein.errors import FailedPrecondition, NotFound, ServiceError, Unavailable
from freerein.types.orchestrator import ENDED, RunState
from freerein_orchestrator.outcomes import Attempt, Reason
from freerein_orchestrator.worker_locks import FileLocks, PostgresLocks, WorkerLocks

_log = logging.getLogger(__name__)
_APPLICATION = "freerein-orchestrator"
_VERSION = "1"  # a constant: DBOS leaves alone what another version began, and its own default is a hash of the code
_QUEUE = "runs"
_WORKFLOW = "run"
_POLL_S = 0.2
_QUEUE_POLL_S = 0.5  # each look costs milliseconds of a core
_STOP_S = 8.0
_PREDECESSOR_S = 2.0
_DATABASE_S = 30.0
_CRASHES = 3

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
        self._url = database_url or f"sqlite:///{folder.absolute() / 'runs.sqlite'}"
        self._executor_id = executor_id
        self._attempt = attempt
        self._note_end = note_end
        self._takeover_s = takeover_s
        self._locks: WorkerLocks = PostgresLocks(database_url) if database_url else FileLocks(folder)
        self._opening, self._opened = threading.Lock(), False
        self._closing = threading.Event()
        self._idle = threading.Condition()
        self._attempts = 0
        self._sweeper = threading.Thread(target=self._sweep, name="takeover", daemon=True)
        self._workflow: Callable[[str], dict[str, Any]] = self._run

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
                return self._run(run_id)

            self._workflow = run
            DBOS.launch()
            DBOS.register_queue(
                _QUEUE, worker_concurrency=1, polling_interval_sec=_QUEUE_POLL_S, on_conflict="always_update"
            )
            self._sweeper.start()
            self._opened = True

    def close(self) -> None:
        """Interrupts the attempt being made, and waits for it; the next start goes on with its run."""
        self._closing.set()
        with self._opening:
            if self._opened:
                self._sweeper.join()
                with self._idle:
                    self._idle.wait_for(lambda: self._attempts == 0, _STOP_S)
                DBOS.destroy(destroy_registry=True)
            self._locks.close()

    def start(self, run_id: str) -> None:
        """Queues a run; one that there is already stays as it is."""
        with _database(), SetWorkflowID(run_id):
            DBOS.enqueue_workflow(_QUEUE, self._workflow, run_id)

    def state(self, run_id: str) -> RunState:
        """Returns where a run stands.

        Raises:
            NotFound: There is none of that id.
        """
        return _state(self._status(run_id))

    def states(self) -> dict[str, RunState]:
        """Returns where every run stands, by id, newest first."""
        with _database():
            found = DBOS.list_workflows(name=_WORKFLOW, sort_desc=True, load_input=False)
        return {status.workflow_id: _state(status) for status in found}

    def cancel(self, run_id: str) -> RunState:
        """Ends a run that has not ended; its worker, whichever that is, stops its attempt soon after.

        Raises:
            NotFound: There is none of that id.
        """
        if self.state(run_id) not in ENDED:
            with _database():
                DBOS.cancel_workflow(run_id)
        return self.state(run_id)

    def resume(self, run_id: str) -> None:
        """Queues a run again that failed or was cancelled; past failures no longer count.

        Raises:
            NotFound: There is none of that id.
            FailedPrecondition: It did neither.
        """
        state = self.state(run_id)
        try:
            if state not in ("failed", "cancelled"):
                raise error.DBOSException("it has not ended, or has succeeded")
            with _database():
                DBOS.rewind_workflow(run_id, queue_name=_QUEUE)
        except error.DBOSException as refused:
            raise FailedPrecondition(
                f"A run to resume must be failed or cancelled; this one is {state}.",
                field="id",
                hint="Start a new run, or cancel this one first.",
            ) from refused

    def _run(self, run_id: str) -> dict[str, Any]:
        """The workflow: attempts until one ends the run, or three in a row got no further."""
        crashes = 0
        while True:
            attempt = Attempt(**DBOS.run_step({"name": "attempt"}, self._make_attempt, run_id))
            crashes = 1 if attempt.progressed else crashes + 1
            if attempt.outcome != "crashed":
                return self._end(run_id, attempt.outcome, attempt.reason)
            if crashes >= _CRASHES:
                return self._end(
                    run_id, "failed", f"{crashes} attempts in a row ended without progress. {attempt.reason}"
                )

    def _end(self, run_id: str, state: RunState, reason: str) -> dict[str, Any]:
        DBOS.run_step({"name": "note_end"}, self._note_end, run_id, state, reason)
        return {"state": state, "reason": reason}

    def _make_attempt(self, run_id: str) -> dict[str, Any]:
        with self._idle:
            self._attempts += 1
        try:
            return asdict(self._attempt(run_id, lambda: self._told_to_stop(run_id)))
        except Exception:  # one run's bug must not leave it without an end
            _log.exception("an attempt failed", extra={"run": run_id})
            return asdict(Attempt("failed", reason="A bug of ours; the log says more."))
        finally:
            with self._idle:
                self._attempts -= 1
                self._idle.notify_all()

    def _told_to_stop(self, run_id: str) -> Reason:
        """Returns whether this worker is closing, or the run is no longer its own: cancelled, or taken over."""
        if self._closing.is_set():
            return "leave"
        try:
            status = self._status(run_id)
        except Unavailable:  # what has begun goes on without the database
            return ""
        if status.status == "CANCELLED":
            return "cancel"
        return "leave" if status.status != "PENDING" or status.executor_id != self._executor_id else ""

    def _status(self, run_id: str) -> WorkflowStatus:
        with _database():
            status = DBOS.get_workflow_status(run_id)
        if status is None:
            raise NotFound("There is no run of this id.", field="id", hint="GET /v1/list-runs names them.")
        return status

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
        """Takes over the runs of workers that are gone."""
        while not self._closing.wait(self._takeover_s):
            try:
                if self._locks.take(self._executor_id):  # once more, if the database was away meanwhile
                    self._take_over()
            except (psycopg.OperationalError, DBAPIError):
                _log.warning("the database of the runs cannot be reached")

    def _take_over(self) -> None:
        running = DBOS.list_workflows(name=_WORKFLOW, status="PENDING", load_input=False, load_output=False)
        for worker in {status.executor_id for status in running}:
            if worker and worker != self._executor_id and self._locks.take(worker):
                try:
                    DBOS._recover_pending_workflows([worker])  # DBOS has no public name for it
                finally:
                    self._locks.free(worker)

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


@contextmanager
def _database() -> Iterator[None]:
    """Says in our words that the database is away."""
    try:
        yield
    except DBAPIError as away:
        raise _unreachable() from away


def _unreachable() -> Unavailable:
    return Unavailable(
        "The database of the runs must be within reach; it is not, or lets nobody in.",
        hint="Start it, create the database, or set FREEREIN_DATABASE_URL to another.",
        retry_after_s=1.0,
    )


def _state(status: WorkflowStatus) -> RunState:
    if status.status == "SUCCESS":
        state: RunState = status.output["state"]  # type: ignore[index]  # what `_end` returned
        return state
    return _STATES[status.status]
