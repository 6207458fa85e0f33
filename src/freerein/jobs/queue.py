"""Runs the jobs of one process on a thread, one at a time, in the order in which they were queued."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from freerein.atomic_files import storage_errors
from freerein.errors import FailedPrecondition, NotFound, Overloaded, ServiceError
from freerein.jobs.attempt import INTERNAL_ERROR, AttemptRunner, AttemptStopped, StopRequest
from freerein.jobs.retry import retry
from freerein.jobs.store import JobStore
from freerein.types.jobs import ENDED, JobState

_log = logging.getLogger(__name__)
_MAX_WAITING = 64
_DISK_S = 1.0
_CANCEL_S = 10.0


class LocalQueue:
    """A queue of jobs. Its methods block, and belong on threads without an event loop.

    `publish` is called with the id of a job whose child has succeeded, unless it was cancelled. It returns what makes
    the result count, which is called unless the job was cancelled meanwhile; from then on it can no longer be. A
    `ServiceError` that one of them raises is the error of the job.
    """

    def __init__(self, store: JobStore, runner: AttemptRunner, *, publish: Callable[[str], Callable[[], None]]) -> None:
        self._store = store
        self._runner = runner
        self._publish = publish
        self._waiting: deque[str] = deque()
        self._running = ""
        self._request: StopRequest = ""
        self._is_decided = False  # the running job has succeeded, and is only recorded
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run_all, name="jobs", daemon=True)

    def start(self) -> None:
        """Starts the thread; resumes the jobs that had not ended when the process last stopped, oldest first."""
        with self._changed:
            self._waiting = deque(self._store.unfinished())
        self._thread.start()

    def close(self) -> None:
        """Stops the child, which saves first; the next start resumes its job."""
        with self._changed:
            self._closing = True
            self._request = "interrupt"
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def check_room(self) -> None:
        """Raises Overloaded when too many jobs are waiting."""
        if len(self._waiting) >= _MAX_WAITING:
            raise Overloaded(
                f"At most {_MAX_WAITING} {self._store.noun}s may wait.", hint="Cancel one, or wait for one to end."
            )

    def put(self, job_id: str) -> None:
        """Queues a job, unless it is queued, running or ended."""
        with self._changed:
            if job_id not in (*self._waiting, self._running) and not self._store.last(job_id).ended:
                self._waiting.append(job_id)
                self._changed.notify_all()

    def cancel(self, job_id: str) -> None:
        """Cancels a job that has not ended; returns when its child is gone."""
        with self._changed:
            if job_id == self._running and self._is_decided:
                self._changed.wait_for(lambda: self._running != job_id, _CANCEL_S)
            self._store.record(job_id, "cancelled")
            if job_id in self._waiting:
                self._waiting.remove(job_id)
            if job_id == self._running:
                self._request = self._request or "cancel"
                self._changed.wait_for(lambda: self._running != job_id, _CANCEL_S)

    def resume(self, job_id: str) -> None:
        """Queues a failed or cancelled job again; its child resumes from its last checkpoint.

        Raises:
            FailedPrecondition: The job is neither failed nor cancelled.
            Overloaded: Too many jobs are waiting, or the child of this one has not ended yet.
        """
        with self._changed:
            self.check_room()
            self._changed.wait_for(lambda: self._running != job_id or not self._store.last(job_id).ended, _CANCEL_S)
            state = self._store.last(job_id).state
            if state not in ("failed", "cancelled"):
                raise FailedPrecondition(
                    f"A {self._store.noun} to resume must be failed or cancelled; this one is {state}.",
                    field="id",
                    hint=f"Start a new {self._store.noun}, or cancel this one if it has not ended.",
                )
            if self._running == job_id:
                raise self._store.still_ending()
            self._store.record(job_id, "queued")
            self._waiting.append(job_id)
            self._changed.notify_all()

    def delete(self, job_id: str) -> None:
        """Deletes a job that has ended.

        Raises:
            NotFound: There is no such job.
            FailedPrecondition: The job has not ended.
            Overloaded: Its child has not ended yet.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._running != job_id or not self._store.last(job_id).ended, _CANCEL_S)
            state = self._store.last(job_id).state
            if state not in ENDED:
                raise self._store.not_ended(job_id, state)
            if self._running == job_id:
                raise self._store.still_ending()
            self._store.delete(job_id)

    def _run_all(self) -> None:
        while job_id := self._next():
            try:
                with storage_errors():
                    self._run(job_id)
            except AttemptStopped:
                pass
            except ServiceError as error:
                self._record(job_id, "failed", error=f"{error.detail} {error.hint}")
            except Exception:  # a bug must not end the queue
                _log.exception("a job failed", extra={"job": job_id})
                self._record(job_id, "failed", error=INTERNAL_ERROR)

    def _run(self, job_id: str) -> None:
        result = retry(partial(self._runner.run, job_id, lambda: self._stop_request(job_id)))
        if self._closing or self._store.last(job_id).ended:  # or cancelled meanwhile
            return
        if result.outcome == "succeeded":
            activate = self._publish(job_id)
            with self._changed:
                if self._store.last(job_id).ended:
                    return
                self._is_decided = True
            activate()
        self._record(job_id, "succeeded" if result.outcome == "succeeded" else "failed", error=result.error)

    def _stop_request(self, job_id: str) -> StopRequest:
        """Returns why a job must stop; another service of this data directory may have cancelled or finished it."""
        return self._request or ("cancel" if self._store.last(job_id).ended else "")

    def _next(self) -> str:
        """Returns the next job, once there is one; empty when the queue closes."""
        with self._changed:
            self._running = ""
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._closing or self._waiting)
            if self._closing:
                return ""
            self._running, self._request, self._is_decided = self._waiting.popleft(), "", False
            return self._running

    def _record(self, job_id: str, state: JobState, **changes: Any) -> None:
        """Records the end of a job, as soon as the disk takes it."""
        while True:
            try:
                return self._store.record(job_id, state, **changes)
            except NotFound:  # its folder was deleted
                return None
            except OSError as error:
                _log.error("the end of a job cannot be recorded yet: %s", error.strerror, extra={"job": job_id})
            if self._closing:
                return None
            time.sleep(_DISK_S)
