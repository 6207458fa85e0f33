"""One attempt at a run: its child process, watched until it ends or is told to stop.

The child is `python -m <module> <folder> <argument>...`. It reads `config.json` in the run's folder, writes
`metrics.jsonl`, checkpoints and `artifacts/` there, goes on from its checkpoints, and ends with exit code 0, or with 2
and one line on stderr when trying again cannot help. On SIGTERM it ends soon, and may save first; there is a file
`cancelled` in the folder by then where the run was cancelled. It ends at once when its standard input closes: then its
parent is gone.
"""

import fcntl
import logging
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from freerein.serving.fits import HOPELESS
from freerein.types.orchestrator import RunState
from freerein_orchestrator.outcomes import CANCELLED, Attempt, Interrupted, Reason
from freerein_orchestrator.runs.records import RunRecords

_log = logging.getLogger(__name__)
_POLL_S = 0.2
_SAVE_S = 5.0
_CANCEL_S = 1.4  # with a look at the database before, two seconds from CancelRun to the child's end
_NOT_ITS_BUSINESS = "FREEREIN_DATABASE_URL"  # holds a password
_ELSEWHERE = (
    "This worker's data directory must hold the run; it does not. Workers that share a database must share "
    "FREEREIN_DATA_DIR."
)
_SIGNALS = {number.value: number.name for number in signal.Signals}


class Attempts:
    """Makes attempts at runs.

    Args:
        records: The runs.
        module: The child's.
        arguments: What its command line holds beside the run's folder.
    """

    def __init__(self, records: RunRecords, *, module: str, arguments: Sequence[str] = ()) -> None:
        self._records = records
        self._module = module
        self._arguments = arguments

    def make(self, run_id: str, stop: Callable[[], Reason]) -> Attempt:
        """Starts a run's child and returns how it ended.

        Args:
            run_id: The run.
            stop: Whether to stop, and why; asked several times a second.

        Raises:
            Interrupted: It was told to stop; the child has ended, or was killed.
        """
        if not self._records.has(run_id):
            return Attempt("failed", reason=_ELSEWHERE)
        try:
            return self._make(run_id, stop)
        except OSError as error:  # a full disk, no memory for a process: perhaps not the next time
            _log.exception("an attempt could not be made", extra={"run": run_id})
            return Attempt("crashed", reason=f"It could not be made: {error.strerror}.")

    def _make(self, run_id: str, stop: Callable[[], Reason]) -> Attempt:
        folder = self._records.folder(run_id)
        before = self._records.last(run_id).step
        with _alone(folder, stop) as lock, (folder / "log.txt").open("ab") as log:
            (folder / CANCELLED).unlink(missing_ok=True)
            if self._records.last(run_id).ended:  # resumed by one who gave up on the database too soon to say so
                self._note(run_id, "queued")
            self._note(run_id, "running")
            child = subprocess.Popen(
                [sys.executable, "-m", self._module, str(folder), *self._arguments],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                env={name: value for name, value in os.environ.items() if name != _NOT_ITS_BUSINESS},
                pass_fds=[lock],  # held until both are gone: a child that outlives us for a moment is never alone
                process_group=0,  # Ctrl-C in a terminal is for us; the child is told in order
            )
            told: Reason = "leave"
            try:
                told = self._watch(run_id, child, stop)
            finally:
                _end(child, _CANCEL_S if told == "cancel" else _SAVE_S)
                self._note_progress(run_id)
        if told:
            raise Interrupted
        progressed = self._records.last(run_id).step > before
        return _judge(child.returncode, _last_line(folder / "log.txt"), progressed=progressed)

    def _watch(self, run_id: str, child: "subprocess.Popen[bytes]", stop: Callable[[], Reason]) -> Reason:
        """Returns why a child is to stop; empty when it has ended of itself."""
        while child.poll() is None:
            if reason := stop():
                if reason == "cancel":
                    with suppress(OSError):
                        (self._records.folder(run_id) / CANCELLED).touch()
                return reason
            self._note_progress(run_id)
            try:
                child.wait(_POLL_S)
            except subprocess.TimeoutExpired:
                continue
        return ""

    def _note_progress(self, run_id: str) -> None:
        metrics = self._records.progress(run_id)
        step = metrics.pop("step", 0)
        if step > self._records.last(run_id).step:
            finite = {name: value for name, value in metrics.items() if _is_finite(value)}
            self._note(run_id, "running", step=step, metrics=finite)

    def _note(self, run_id: str, state: RunState, **changes: Any) -> None:
        try:
            self._records.note(run_id, state, **changes)
        except OSError:  # a full disk ends no run; what can be noted later will be
            _log.warning("progress cannot be noted", extra={"run": run_id})


@contextmanager
def _alone(folder: Path, stop: Callable[[], Reason]) -> Iterator[int]:
    """Yields the lock of a run's folder, once the child of an earlier attempt, which holds it too, is gone."""
    lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT, 0o644)
    try:
        while not _take(lock):
            if stop():
                raise Interrupted
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


def _end(child: "subprocess.Popen[bytes]", patience_s: float) -> None:
    """Returns when a child has ended: SIGTERM, and SIGKILL for one that takes too long."""
    if child.poll() is None:
        child.terminate()
    try:
        child.wait(patience_s)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
    if child.stdin is not None:
        child.stdin.close()


def _judge(code: int, complaint: str, *, progressed: bool) -> Attempt:
    if code == 0:
        return Attempt("succeeded")
    if code == HOPELESS:
        return Attempt("failed", progressed, complaint)
    killer = _SIGNALS.get(-code, f"signal {-code}")
    ended = f"was killed by {killer}" if code < 0 else f"ended with exit code {code}"
    return Attempt("crashed", progressed, f"Its process {ended}; the run's log says more.")


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _last_line(path: Path) -> str:
    with path.open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - 4096))
        lines = file.read().splitlines()
    return lines[-1].decode(errors="replace") if lines else ""
