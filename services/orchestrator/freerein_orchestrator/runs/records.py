"""Runs on disk, where every worker and every child process finds them. The database says which runs there are.

<root>/<id>/config.json    kind, configuration and steps planned, for the child process
<root>/<id>/request.json   what StartRun was sent, written before the run is queued
<root>/<id>/events.jsonl   the run after each change, numbered from 0 by line; the last line is how it stands
<root>/<id>/metrics.jsonl  written by the child, one line a step
<root>/<id>/checkpoints/   the child's own
<root>/<id>/tensorboard/   the same, for TensorBoard
<root>/<id>/model.json     the model that it made for a service
<root>/<id>/artifacts/     what the run leaves behind
<root>/<id>/log.txt        what its child processes said
"""

import fcntl
import json
import os
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from freerein.atomic_files import write_atomic
from freerein.errors import AlreadyExists, NotFound
from freerein.types.common import ModelRef, check_id, check_name
from freerein.types.orchestrator import ENDED, Artifact, RunState, StartRunRequest

_TAIL = 65536
_KEYS = uuid.UUID("6f5e3b1c-52a4-4c43-9a58-0a6f1a1f6c54")


@dataclass(frozen=True)
class RunEvent:
    """How a run stood after a change.

    Attributes:
        sequence: Its number, from 0; a watcher that names the next one misses nothing.
        state: Where the run stood.
        step: The last step made.
        metrics: Of that step.
        reason: Why it failed, else empty.
    """

    sequence: int
    state: RunState
    step: int = 0
    metrics: dict[str, float] = field(default_factory=dict)
    reason: str = ""

    @property
    def ended(self) -> bool:
        """Whether the run had ended."""
        return self.state in ENDED


class RunRecords:
    """The runs of one data directory. Any number of processes may read and append at the same time.

    Args:
        root: Where they lie.
    """

    def __init__(self, root: Path) -> None:
        self._root = root

    def folder(self, run_id: str) -> Path:
        """Returns a run's folder.

        Raises:
            InvalidInput: That is no id.
        """
        return self._root / check_id(run_id, field="id")

    def add(self, request: StartRunRequest, config: Mapping[str, Any], *, steps: int = 0) -> str:
        """Records a request, durably, and returns the id of its run, which is the same for the same idempotency key.

        Args:
            request: What was asked for.
            config: The whole configuration, defaults filled in.
            steps: How many steps it takes.

        Raises:
            AlreadyExists: The idempotency key belongs to another request.
        """
        key = request.idempotency_key
        run_id = _id(key) if key else uuid.uuid4().hex
        folder = self.folder(run_id)
        folder.mkdir(parents=True, exist_ok=True)
        with _appending(folder / "events.jsonl") as file:
            if _last(file) is None:
                _append(file, {"state": "queued"})
            if self.started_by(request) is None:
                body = {"kind": request.kind, "config": dict(config), "steps": steps}
                write_atomic(folder / "config.json", json.dumps(body).encode())
                write_atomic(folder / "request.json", json.dumps(asdict(request)).encode())
        return run_id

    def started_by(self, request: StartRunRequest) -> str | None:
        """Returns the id of the run that a request's idempotency key has started; None when there is none.

        Raises:
            AlreadyExists: The idempotency key belongs to another request.
        """
        run_id = _id(request.idempotency_key)
        asked = self.folder(run_id) / "request.json"
        if not request.idempotency_key or not asked.is_file():
            return None
        if StartRunRequest(**json.loads(asked.read_bytes())) != request:
            raise AlreadyExists(
                "An idempotency key belongs to one request; this one was used for another.",
                field="idempotency_key",
                hint="Choose a new key for a new run.",
            )
        return run_id

    @contextmanager
    def settling(self, run_id: str) -> Iterator[None]:
        """Lets nobody else, in any process, settle meanwhile whether a run has ended or is queued again."""
        with (self.folder(run_id) / "settling.lock").open("ab") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def has(self, run_id: str) -> bool:
        """Returns whether a run's folder is there."""
        return (self.folder(run_id) / "config.json").is_file()

    def config(self, run_id: str) -> dict[str, Any]:
        """Returns a run's `kind`, `config` and `steps`.

        Raises:
            NotFound: There is none of that id.
        """
        if not self.has(run_id):
            raise NotFound("There is no run of this id.", field="id", hint="GET /v1/list-runs names them.")
        body: dict[str, Any] = json.loads((self.folder(run_id) / "config.json").read_bytes())
        return body

    def note(self, run_id: str, state: RunState, **changes: Any) -> None:
        """Appends an event, durably.

        Nothing when it says what the last one said, or when the run had ended: only `queued` follows an end.

        Args:
            run_id: The run's id.
            state: Where it stands.
            changes: `step`, `metrics` and `reason`, where they are others than before.
        """
        with _appending(self.folder(run_id) / "events.jsonl") as file:
            before = _last(file) or {}
            after = {**before, "reason": "", **changes, "state": state}
            if after != {"reason": "", **before} and (before.get("state") not in ENDED or state == "queued"):
                _append(file, after)

    def last(self, run_id: str) -> RunEvent:
        """Returns a run's last event; its `sequence` is not counted and 0."""
        with (self.folder(run_id) / "events.jsonl").open("rb") as file:
            return RunEvent(0, **(_last(file) or {"state": "queued"}))

    def watch(self, run_id: str) -> "EventTail":
        """Returns what reads a run's events, the old and then the new ones."""
        return EventTail(self.folder(run_id) / "events.jsonl")

    def progress(self, run_id: str) -> dict[str, Any]:
        """Returns the last whole line of a run's metrics, empty when there is none."""
        path = self.folder(run_id) / "metrics.jsonl"
        if not path.is_file():
            return {}
        with path.open("rb") as file:
            return _last(file) or {}

    def model(self, run_id: str) -> ModelRef | None:
        """Returns the model that a run has made for a service; None when there is none."""
        path = self.folder(run_id) / "model.json"
        return ModelRef(**json.loads(path.read_bytes())) if path.is_file() else None

    def artifacts(self, run_id: str) -> tuple[Artifact, ...]:
        """Returns what a run has left behind, by name."""
        files = sorted((self.folder(run_id) / "artifacts").glob("[!.]*"))
        return tuple(Artifact(path.name, path.stat().st_size) for path in files if path.is_file())

    def artifact(self, run_id: str, name: str) -> Path:
        """Returns where an artifact lies.

        Raises:
            NotFound: There is none of that name.
        """
        path = self.folder(run_id) / "artifacts" / check_name(name, field="name")
        if not path.is_file():
            raise NotFound("The run has no artifact of this name.", field="name", hint="List its artifacts.")
        return path


class EventTail:
    """Reads events once each, while others append."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0
        self._count = 0

    def read(self) -> list[RunEvent]:
        """Returns the events that are new since the last call."""
        if self._path.stat().st_size <= self._offset:
            return []
        with self._path.open("rb") as file:
            file.seek(self._offset)
            whole = file.read().rpartition(b"\n")
        lines = whole[0].splitlines() if whole[1] else []
        events = [RunEvent(self._count + index, **json.loads(line)) for index, line in enumerate(lines)]
        self._offset += len(whole[0]) + len(whole[1])
        self._count += len(events)
        return events


def _id(idempotency_key: str) -> str:
    return uuid.uuid5(_KEYS, idempotency_key).hex


@contextmanager
def _appending(path: Path) -> Iterator[BinaryIO]:
    """Yields a file of lines to append to, alone; a last line that a crash tore is cut off."""
    with path.open("a+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        tail = _tail(file)
        if torn := len(tail) - (tail.rfind(b"\n") + 1):
            file.truncate(file.seek(0, os.SEEK_END) - torn)
        yield file


def _append(file: BinaryIO, values: Mapping[str, Any]) -> None:
    file.write(json.dumps(values).encode() + b"\n")
    file.flush()
    os.fsync(file.fileno())


def _last(file: BinaryIO) -> dict[str, Any] | None:
    lines = _tail(file).rpartition(b"\n")[0].splitlines()
    if not lines:
        return None
    values: dict[str, Any] = json.loads(lines[-1])
    return values


def _tail(file: BinaryIO) -> bytes:
    file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL))
    return file.read()
