"""One attempt at a job: a child process, watched until it ends or must stop.

The child is `python -m <module> <folder> <argument>...`; `freerein.jobs.child` says what it does. On SIGTERM it saves
and exits; if the job was cancelled, its folder then holds a file `cancelled`.
"""

import fcntl
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from freerein.jobs.child import PERMANENT_FAILURE
from freerein.jobs.json_lines import LineReader
from freerein.jobs.metrics import metric_row
from freerein.jobs.store import JobStore
from freerein.types.jobs import MetricRow

_log = logging.getLogger(__name__)
_POLL_S = 0.2
_SAVE_S = 5.0
_CANCEL_S = 1.4  # with a look at the database before, two seconds from CancelRun to the child's end
_ATTEMPTS = 3
_SIGNALS = {number.value: number.name for number in signal.Signals}

StopRequest = Literal["", "interrupt", "cancel"]
"""Why an attempt must stop: another attempt will resume the job, or the job was cancelled; empty to continue."""

CANCELLED_FILE = "cancelled"
INTERNAL_ERROR = "Internal error; the log of the service has the traceback."


@dataclass(frozen=True)
class AttemptResult:
    """How an attempt ended.

    Attributes:
        outcome: `succeeded` and `failed` end the job; after `crashed` it is attempted again.
        progressed: Whether the attempt did steps that no attempt before it had done.
        error: Why it failed or crashed.
    """

    outcome: Literal["succeeded", "failed", "crashed"]
    progressed: bool = False
    error: str = ""


class AttemptStopped(BaseException):
    """Ends an attempt that was asked to stop. It has no result: if the job continues, it is attempted again.

    Not an `Exception`, which DBOS would record as the end of the run.
    """


def retry(attempt: Callable[[], AttemptResult]) -> AttemptResult:
    """Makes attempts at a job until one ends it, or three in a row crash without progress."""
    crashes = 0
    while True:
        result = attempt()
        if result.outcome != "crashed":
            return result
        crashes = 0 if result.progressed else crashes + 1
        if crashes >= _ATTEMPTS:
            return AttemptResult("failed", error=f"{crashes} attempts in a row ended without progress. {result.error}")


class AttemptRunner:
    """Makes attempts at jobs.

    Args:
        store: The jobs.
        module: Module of the child process.
        arguments: Arguments of the child process after the job's folder.
        hidden: Environment variables that the child process must not see.
    """

    def __init__(
        self, store: JobStore, *, module: str, arguments: Sequence[str] = (), hidden: Sequence[str] = ()
    ) -> None:
        self._store = store
        self._command = (sys.executable, "-m", module)
        self._arguments = arguments
        self._hidden = hidden

    def run(self, job_id: str, should_stop: Callable[[], StopRequest]) -> AttemptResult:
        """Starts a job's child process and returns how it ended.

        Args:
            job_id: The job.
            should_stop: Called several times a second.

        Raises:
            AttemptStopped: `should_stop` asked for it; the child has ended or was killed.
        """
        if not self._store.exists(job_id):
            return AttemptResult(
                "failed",
                error="The data directory of this worker must hold the job; it does not. Workers that share a database "
                "must share FREEREIN_DATA_DIR.",
            )
        try:
            return self._run(job_id, should_stop)
        except OSError as error:  # a full disk, or no memory for a process: the next attempt may succeed
            _log.exception("an attempt could not be started", extra={"job": job_id})
            return AttemptResult("crashed", error=f"It could not be started: {error.strerror}.")

    def _run(self, job_id: str, should_stop: Callable[[], StopRequest]) -> AttemptResult:
        folder, done = self._store.folder(job_id), self._store.last(job_id).step
        progress = _Progress(self._store, job_id)
        with _locked(folder, should_stop) as lock, (folder / "log.txt").open("ab") as log:
            (folder / CANCELLED_FILE).unlink(missing_ok=True)
            with _ignoring_full_disk(job_id):
                self._store.record(job_id, "running")
            child = subprocess.Popen(
                [*self._command, str(folder), *self._arguments],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                env={name: value for name, value in os.environ.items() if name not in self._hidden},
                pass_fds=[lock],  # held until both are gone: a child that outlives us for a moment excludes the next
                process_group=0,  # Ctrl-C in a terminal reaches us, and the child in order
            )
            request: StopRequest = "interrupt"
            try:
                request = _watch(child, should_stop, progress)
                if request == "cancel":
                    with suppress(OSError):
                        (folder / CANCELLED_FILE).touch()
            finally:
                _end(child, _CANCEL_S if request == "cancel" else _SAVE_S)
                progress.record_all()
        if request:
            raise AttemptStopped
        progressed = self._store.last(job_id).step > done
        return _result(child.returncode, _last_line(folder / "log.txt"), progressed=progressed)


class _Progress:
    """Records the rows of metrics that a child writes as events of its job."""

    def __init__(self, store: JobStore, job_id: str) -> None:
        self._store = store
        self._job_id = job_id
        self._lines = LineReader(store.folder(job_id) / "metrics.jsonl")
        self._unrecorded: list[MetricRow] = []

    def record(self) -> bool:
        """Records the next rows; returns whether there may be more."""
        self._unrecorded = self._unrecorded or [metric_row(document) for document in self._lines.read()]
        if not self._unrecorded:
            return False
        with _ignoring_full_disk(self._job_id):
            self._store.record_progress(self._job_id, self._unrecorded)
            self._unrecorded = []
        return not self._unrecorded

    def record_all(self) -> None:
        """Records all rows, as far as the disk allows."""
        while self.record():
            pass


def _watch(
    child: "subprocess.Popen[bytes]", should_stop: Callable[[], StopRequest], progress: _Progress
) -> StopRequest:
    """Returns why a child must stop; empty when it has ended by itself."""
    while child.poll() is None:
        if request := should_stop():
            return request
        progress.record()
        with suppress(subprocess.TimeoutExpired):
            child.wait(_POLL_S)
    return ""


@contextmanager
def _ignoring_full_disk(job_id: str) -> Iterator[None]:
    """A full disk ends no job: what cannot be recorded now is recorded later."""
    try:
        yield
    except OSError:
        _log.warning("progress cannot be recorded", extra={"job": job_id})


@contextmanager
def _locked(folder: Path, should_stop: Callable[[], StopRequest]) -> Iterator[int]:
    """Yields the lock of a job's folder, once the child of an earlier attempt, which holds it too, has ended."""
    lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT, 0o644)
    try:
        while not _take(lock):
            if should_stop():
                raise AttemptStopped
            time.sleep(_POLL_S)
        yield lock
    finally:
        os.close(lock)


def _take(lock: int) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _end(child: "subprocess.Popen[bytes]", timeout_s: float) -> None:
    """Returns when a child has ended: SIGTERM, and SIGKILL after a timeout."""
    if child.poll() is None:
        child.terminate()
    try:
        child.wait(timeout_s)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
    if child.stdin is not None:
        child.stdin.close()


def _result(code: int, last_line: str, *, progressed: bool) -> AttemptResult:
    if code == 0:
        return AttemptResult("succeeded")
    if code == PERMANENT_FAILURE:
        return AttemptResult("failed", progressed, last_line)
    name = _SIGNALS.get(-code, f"signal {-code}")
    ended = f"was killed by {name}" if code < 0 else f"ended with exit code {code}"
    return AttemptResult("crashed", progressed, f"Its process {ended}; its log.txt says more.")


def _last_line(path: Path) -> str:
    with path.open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - 4096))
        lines = file.read().splitlines()
    return lines[-1].decode(errors="replace") if lines else ""
