"""One attempt at a job: a child process, watched until it ends or must stop.

The child is `python -m <module> <folder> <argument>...`; `freerein.jobs.child` says what it does. On SIGTERM it saves
and exits; if the job was cancelled, its folder then holds a file `cancelled`.
"""

import errno
import logging
import os
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Literal

from freerein.atomic_files import out_of_storage
from freerein.errors import NotFound
from freerein.fork_server import ChildProcess, Program, StartChild, spawn
from freerein.jobs.child import OUT_OF_STORAGE, PERMANENT_FAILURE, STOPPED, locked
from freerein.jobs.json_lines import LineReader
from freerein.jobs.metrics import metric_row
from freerein.jobs.retry import NO_PAUSE, AttemptResult, Pause
from freerein.jobs.standstill import STANDSTILL_S, Standstill
from freerein.jobs.store import JobStore

_log = logging.getLogger(__name__)
_POLL_S = 0.2
_SAVE_S = 5.0
_CANCEL_S = 1.4  # with one poll of the database, at most 2 s from CancelRun to the child's end
_SIGNALS = {number.value: number.name for number in signal.Signals}
_KILLS = {-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP, STOPPED}

_SHORTAGES = {errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.ENOMEM}  # of files, processes or memory

StopRequest = Literal["", "interrupt", "cancel"]
"""Why an attempt must stop: another attempt will resume the job, or the job was cancelled; empty to continue."""

_STANDSTILL: Literal["standstill"] = "standstill"

CANCELLED_FILE = "cancelled"
WAITING_FILE = "waiting"
INTERNAL_ERROR = "Internal error; the log of the service has the traceback."


class AttemptStopped(BaseException):
    """Ends an attempt that was asked to stop. It has no result: if the job continues, it is attempted again.

    Not an `Exception`, which DBOS would record as the end of the run.
    """


class AttemptRunner:
    """Makes attempts at jobs.

    The child process is a module with arguments after the job's folder, without some environment variables. After
    `standstill_s` without progress and CPU time it is ended; see `freerein.jobs.standstill`.
    """

    def __init__(
        self,
        store: JobStore,
        *,
        module: str,
        arguments: Sequence[str] = (),
        hidden_env: Sequence[str] = (),
        start_child: StartChild = spawn,
        standstill_s: float = STANDSTILL_S,
    ) -> None:
        self._store = store
        self._module = module
        self._arguments = arguments
        self._hidden_env = hidden_env
        self._start_child = start_child
        self._standstill_s = standstill_s

    def run(self, job_id: str, should_stop: Callable[[], StopRequest], pause: Pause = NO_PAUSE) -> AttemptResult:
        """Starts a job's child process after a pause, and returns how it ended.

        `should_stop` is called several times a second.

        Raises AttemptStopped when `should_stop` asked for it; the child has then ended or was killed.
        """
        try:
            self._store.check(job_id)
            return self._attempt(job_id, should_stop, pause)
        except NotFound:
            return AttemptResult(
                "failed",
                error="The data directory of this worker must hold the job; it does not. Workers that share a database "
                "must share FREEREIN_DATA_DIR, and the folder of a job must not be deleted before it ends.",
            )

    def _attempt(self, job_id: str, should_stop: Callable[[], StopRequest], pause: Pause) -> AttemptResult:
        with ExitStack() as held:
            try:
                self._wait(job_id, should_stop, pause)
                child = self._start(job_id, should_stop, held)
            except OSError as error:
                return _broken_off(job_id, "The child process could not be started", error)
            try:
                return self._follow(job_id, child, should_stop)
            except OSError as error:
                return _broken_off(job_id, "The child process was ended, for its files could not be read", error)

    def _wait(self, job_id: str, should_stop: Callable[[], StopRequest], pause: Pause) -> None:
        """Waits out a pause, which the job's events show."""
        if pause.seconds:
            with suppress(OSError):
                error = f"{pause.reason} The next attempt begins after {pause.seconds:g} s."
                self._store.record(job_id, "running", error=error)
        end_s = time.monotonic() + pause.seconds
        while (left_s := end_s - time.monotonic()) > 0:
            if should_stop():
                raise AttemptStopped
            time.sleep(min(left_s, _POLL_S))

    def _start(self, job_id: str, should_stop: Callable[[], StopRequest], held: ExitStack) -> ChildProcess:
        """Returns a new child process; `held` has the lock of the job's folder from then on, and the child's stdin."""
        folder = self._store.folder(job_id)
        lock = held.enter_context(locked(folder, should_stop))
        if lock is None or should_stop():
            raise AttemptStopped
        for name in (CANCELLED_FILE, WAITING_FILE):
            (folder / name).unlink(missing_ok=True)
        with suppress(OSError):  # a full disk ends no job: what cannot be recorded now is recorded later
            self._store.record(job_id, "running")
        stdin, held_open = os.pipe()
        held.callback(os.close, held_open)
        with os.fdopen(stdin), (folder / "log.txt").open("ab") as log:
            program = Program(
                self._module,
                (str(folder), *self._arguments),
                {name: value for name, value in os.environ.items() if name not in self._hidden_env},
                stdin=stdin,
                stdout=log.fileno(),
                stderr=log.fileno(),
                keep=[lock],  # held until both are gone: a child that outlives us for a moment excludes the next
            )
            return self._start_child(program)

    def _follow(self, job_id: str, child: ChildProcess, should_stop: Callable[[], StopRequest]) -> AttemptResult:
        """Records the child's progress until it ends or must stop; it has ended, or was killed, however this ends."""
        folder = self._store.folder(job_id)
        rows = LineReader(folder / "metrics.jsonl")
        request: StopRequest | Literal["standstill"] = "interrupt"
        try:
            done = self._store.last(job_id).step
            request = self._watch(job_id, child, rows, should_stop)
        finally:
            _end(child, _CANCEL_S if request == "cancel" else _SAVE_S)
            while self._record_progress(job_id, rows):
                pass
        progressed = self._store.last(job_id).step > done
        if request == _STANDSTILL:
            error = (
                f"The child process did nothing for {self._standstill_s:g} s and was ended: a file or file system that "
                "it reads does not answer. Mend that, then resume."
            )
            return AttemptResult("crashed" if progressed else "failed", progressed, error)
        if request:
            raise AttemptStopped
        return _result(child.wait(), _last_line(folder / "log.txt"), progressed=progressed)

    def _watch(
        self, job_id: str, child: ChildProcess, rows: LineReader, should_stop: Callable[[], StopRequest]
    ) -> StopRequest | Literal["standstill"]:
        """Returns why a child must stop; empty when it has ended by itself. Raises NotFound when its job is deleted."""
        waits, standstill = "", Standstill(child.pid, limit_s=self._standstill_s)
        while child.poll() is None:
            self._store.check(job_id)
            if request := should_stop():
                if request == "cancel":
                    with suppress(OSError):
                        (self._store.folder(job_id) / CANCELLED_FILE).touch()
                return request
            progressed = self._record_progress(job_id, rows)
            waits = self._record_wait(job_id, waits)
            if standstill.is_reached(progressed=progressed or bool(waits)):
                return _STANDSTILL
            with suppress(subprocess.TimeoutExpired):
                child.wait(_POLL_S)
        return ""

    def _record_progress(self, job_id: str, rows: LineReader) -> bool:
        """Records the next rows of metrics as events, later if the disk is full; returns whether it recorded any."""
        if new := [metric_row(document) for document in rows.read()]:
            try:
                self._store.record_progress(job_id, new)
            except OSError:
                _log.warning("progress cannot be recorded", extra={"job": job_id})
                rows.unread()
                return False
        return bool(new)

    def _record_wait(self, job_id: str, before: str) -> str:
        """Records why the child waits, if that is not as before; returns it."""
        with suppress(OSError):
            path = self._store.folder(job_id) / WAITING_FILE
            reason = path.read_text() if path.exists() else ""
            if reason != before:
                self._store.record(job_id, "running", error=reason)
            return reason
        return before


def _broken_off(job_id: str, what: str, error: OSError) -> AttemptResult:
    """Returns the end of an attempt; the next may succeed: after a pause, where the machine is short of something."""
    _log.error("an attempt was broken off", exc_info=error, extra={"job": job_id})
    return AttemptResult("killed" if error.errno in _SHORTAGES else "crashed", error=f"{what}: {error.strerror}.")


def _end(child: ChildProcess, timeout_s: float) -> None:
    """Returns when a child has ended: SIGTERM, and SIGKILL after a timeout."""
    child.send_signal(signal.SIGTERM)
    try:
        child.wait(timeout_s)
    except subprocess.TimeoutExpired:
        child.send_signal(signal.SIGKILL)
        child.wait()


def _result(code: int, last_line: str, *, progressed: bool) -> AttemptResult:
    if code == 0:
        return AttemptResult("succeeded")
    if code == PERMANENT_FAILURE:
        return AttemptResult("failed", progressed, last_line)
    if code == OUT_OF_STORAGE:
        refused = out_of_storage("the disk is full, broken or read-only")
        return AttemptResult("failed", progressed, f"{refused.detail} {refused.hint}")
    name = "SIGTERM" if code == STOPPED else _SIGNALS.get(-code, f"signal {-code}")
    if code in _KILLS:
        cause = f"{name}, or memory ran out" if code == -signal.SIGKILL else name
        return AttemptResult("killed", progressed, f"The child process was killed by {cause}.")
    ended = f"was killed by {name}" if code < 0 else f"ended with exit code {code}"
    return AttemptResult("crashed", progressed, f"The child process {ended}; see log.txt in the job's folder.")


def _last_line(path: Path) -> str:
    with path.open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - 4096))
        lines = file.read().splitlines()
    return lines[-1].decode(errors="replace") if lines else ""
