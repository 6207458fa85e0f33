"""One attempt at a run: its child process, watched until it ends or is told to stop.

The child is `python -m <module> <folder> <argument>...`. It reads `config.json` in the run's folder, writes
`metrics.jsonl`, checkpoints and `artifacts/` there, goes on from its checkpoints, and ends with exit code 0, or with 2
and one line on stderr when trying again cannot help. On SIGTERM it saves and ends; there is a file `cancelled` in the
folder by then where the run was cancelled. It ends at once when its standard input closes: then its parent is gone.
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
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from freerein.serving.fits import HOPELESS
from freerein_orchestrator.outcomes import CANCELLED, Attempt, Interrupted, Reason
from freerein_orchestrator.runs.records import RunRecords

_log = logging.getLogger(__name__)
_POLL_S = 0.2
_SAVE_S = 5.0


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
            Interrupted: It was told to stop; the child has saved and ended, or was killed.
        """
        folder = self._records.folder(run_id)
        before = self._records.last(run_id).step
        with _alone(folder, stop) as lock, (folder / "log.txt").open("ab") as log:
            (folder / CANCELLED).unlink(missing_ok=True)
            self._records.note(run_id, "running")
            child = subprocess.Popen(
                [sys.executable, "-m", self._module, str(folder), *self._arguments],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                pass_fds=[lock],  # held until both are gone: a child that outlives us for a moment is never alone
                process_group=0,  # Ctrl-C in a terminal is for us; the child is told in order
            )
            try:
                self._watch(run_id, child, stop)
            finally:
                _end(child)
                self._note_progress(run_id)
        progressed = self._records.last(run_id).step > before
        return _judge(child.returncode, _last_line(folder / "log.txt"), progressed=progressed)

    def _watch(self, run_id: str, child: "subprocess.Popen[bytes]", stop: Callable[[], Reason]) -> None:
        while child.poll() is None:
            if reason := stop():
                if reason == "cancel":
                    (self._records.folder(run_id) / CANCELLED).touch()
                raise Interrupted
            self._note_progress(run_id)
            try:
                child.wait(_POLL_S)
            except subprocess.TimeoutExpired:
                continue

    def _note_progress(self, run_id: str) -> None:
        metrics = self._records.progress(run_id)
        step = metrics.pop("step", 0)
        if step > self._records.last(run_id).step:
            finite = {name: value for name, value in metrics.items() if _is_finite(value)}
            try:
                self._records.note(run_id, "running", step=step, metrics=finite)
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


def _end(child: "subprocess.Popen[bytes]") -> None:
    """Returns when a child has ended: SIGTERM, and SIGKILL for one that takes too long to save."""
    if child.poll() is None:
        child.terminate()
    try:
        child.wait(_SAVE_S)
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
    ended = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    return Attempt("crashed", progressed, f"Its process {ended}; the run's log says more.")


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _last_line(path: Path) -> str:
    lines = path.read_bytes()[-4096:].splitlines()
    return lines[-1].decode(errors="replace") if lines else ""
