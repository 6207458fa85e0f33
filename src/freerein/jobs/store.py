"""Jobs on disk. Any number of processes may read and append at the same time.

<root>/.lock               held while a job is made
<root>/<id>/request.json   the request, as received
            config.json    resolved configuration and planned steps; written last
            events.jsonl   the job after each change; the line number is the sequence number
            metrics.jsonl  written by the child process, one row per logged step
            model.json     the resulting model
            artifacts/     files for the user
            log.txt        output of the child processes
            lock           held by an attempt and its child process
            state.lock     held while it is decided whether the job has ended

A job is there while the first three of these files are. Its folder may be deleted at any time, which takes a while.
"""

import asyncio
import fcntl
import json
import logging
import re
import shutil
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any

from freerein.atomic_files import delete_folder, locked, make_folder, write_atomic
from freerein.errors import AlreadyExists, FailedPrecondition, InvalidInput, NotFound, Overloaded, must_be
from freerein.jobs.json_lines import LineReader, append, last_document
from freerein.jobs.metrics import read_metrics
from freerein.jobs.names import job_name, link_by_name, remove_broken
from freerein.jobs.wall_clock import now_ns
from freerein.types.common import ModelRef, check_id, check_name
from freerein.types.jobs import ENDED, JobMetrics, JobMetricsRequest, JobState, MetricRow
from freerein.types.orchestrator import Artifact

_log = logging.getLogger(__name__)
_FILES = ("request.json", "config.json", "events.jsonl")
_KEYS = uuid.UUID("6f5e3b1c-52a4-4c43-9a58-0a6f1a1f6c54")
_PAGE, _MAX_PAGE = 100, 1000
_PAGE_BYTES = 1 << 20  # of JSON; a `Struct` with the same values takes up to six times as many
_ROWS, _MAX_ROWS = 1000, 10_000


@dataclass(frozen=True)
class JobEvent:
    """A job after a change; `error` is empty unless the job has failed, `time_ns` 0 where no time was recorded."""

    state: JobState = "queued"
    step: int = 0
    metrics: dict[str, float] = field(default_factory=dict)
    error: str = ""
    time_ns: int = 0

    @property
    def ended(self) -> bool:
        """Whether the job had ended."""
        return self.state in ENDED


class JobStore:
    """The jobs of one folder.

    Args:
        root: The folder.
        noun: What a job is called in errors: `fit` or `run`.
        clock_ns: Returns the Unix time in nanoseconds, the time of events.
        links: Folder of links to the jobs by readable names; None for none.
    """

    def __init__(
        self, root: Path, *, noun: str, clock_ns: Callable[[], int] = now_ns, links: Path | None = None
    ) -> None:
        self._root = root
        self._links = links
        self.noun = noun
        self._clock_ns = clock_ns

    def folder(self, job_id: str) -> Path:
        """Returns the folder of a job. Raises InvalidInput for a malformed id."""
        return self._root / check_id(job_id, field="id")

    def create(self, request: Mapping[str, Any], config: Mapping[str, Any]) -> str:
        """Records a request and the contents of `config.json` durably; returns the id of the job.

        The same idempotency key is the same job. Raises AlreadyExists when it was used for another request, OSError
        when the disk is full or broken; nothing is then left of the job.
        """
        job_id = id_of(request["idempotency_key"]) if request["idempotency_key"] else uuid.uuid4().hex
        folder = self.folder(job_id)
        make_folder(self._root)
        with locked(self._root / ".lock"):
            if self.find(request) is None:
                try:
                    make_folder(folder)
                    append(folder / "events.jsonl", lambda last: [] if last else [self._now({})])
                    write_atomic(folder / "request.json", json.dumps(request).encode())
                    write_atomic(folder / "config.json", json.dumps(config).encode())
                except OSError:
                    if not self.exists(job_id):
                        shutil.rmtree(folder, ignore_errors=True)
                    raise
                if self._links is not None:
                    link_by_name(self._links, folder, self._name(config))
        return job_id

    def find(self, request: Mapping[str, Any]) -> str | None:
        """Returns the id of the job started with a request's idempotency key; None when there is none.

        Raises AlreadyExists when the key was used for another request.
        """
        job_id = id_of(request["idempotency_key"])
        if not request["idempotency_key"] or not self.exists(job_id):
            return None
        if json.loads((self.folder(job_id) / "request.json").read_bytes()) != json.loads(json.dumps(request)):
            raise AlreadyExists(
                "An idempotency key must be used for one request; this one was used for another.",
                field="idempotency_key",
                hint=f"Choose a new key for a new {self.noun}.",
            )
        return job_id

    def exists(self, job_id: str) -> bool:
        """Returns whether there is a job of an id."""
        folder = self.folder(job_id)
        return all((folder / name).exists() for name in _FILES)

    def check(self, job_id: str) -> None:
        """Raises NotFound when there is no job of an id."""
        if not self.exists(job_id):
            raise self._not_found()

    def config(self, job_id: str) -> dict[str, Any]:
        """Returns the contents of a job's `config.json`. Raises NotFound when there is no such job."""
        self.check(job_id)
        with self._deleted_is_not_found():
            return dict(json.loads((self.folder(job_id) / "config.json").read_bytes()))

    def delete(self, job_id: str) -> None:
        """Deletes a job that has ended: it is gone at once, and then its files are.

        Raises NotFound when there is no such job, Overloaded while its last child process is still ending.
        """
        self.check(job_id)
        with self._deleted_is_not_found(), (self.folder(job_id) / "lock").open("ab") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise self.still_ending() from None
            delete_folder(self.folder(job_id))
        if self._links is not None:
            remove_broken(self._links)

    def not_ended(self, job_id: str, state: JobState) -> FailedPrecondition:
        """Returns the error of a job that cannot be deleted yet."""
        return FailedPrecondition(
            f"A {self.noun} to delete must have ended; {job_id[:8]} is {state}.",
            field="id",
            hint="Cancel it, or wait for its end.",
        )

    def still_ending(self) -> Overloaded:
        """Returns the error of a job that has ended, but for its last child process."""
        return Overloaded(f"The last child of this {self.noun} is still ending.", hint="Try again.")

    def page(self, page_size: int, page_token: str) -> tuple[list[str], str]:
        """Returns the ids of one page of jobs, newest first, and the token of the next page, empty on the last.

        A page ends early, after at least one job, so that the configurations on it have at most 1 MiB together.

        The token is the place of a page's last job, which may be deleted before the next page is asked for.

        Raises InvalidInput when the page is too large, or the token was not returned by this method.
        """
        size = _bounded(page_size, default=_PAGE, most=_MAX_PAGE, field="page_size")
        sizes = self._newest_first()
        if page_token:
            last = _place(page_token)
            sizes = {place: each for place, each in sizes.items() if place < last}
        places = list(sizes)
        ends = accumulate(sizes[place] for place in places[:size])
        end = max(1, sum(total <= _PAGE_BYTES for total in ends))
        token = "{}-{}".format(*places[end - 1]) if end < len(places) else ""
        return [job_id for _, job_id in places[:end]], token

    def unfinished(self) -> list[str]:
        """Returns the ids of the jobs that have not ended, oldest first, without those that cannot be read."""
        return [job_id for _, job_id in reversed(self._newest_first()) if self._is_unfinished(job_id)]

    def record(self, job_id: str, state: JobState, **changes: Any) -> None:
        """Appends an event durably, unless nothing changes. An ended job changes only to `queued`.

        `changes` are `step`, `metrics` and `error`. Raises NotFound when there is no such job, OSError when the disk is
        full or broken.
        """
        self._append(job_id, [{**changes, "state": state}])

    def record_progress(self, job_id: str, rows: Sequence[MetricRow]) -> None:
        """Appends an event for each row whose step is new; raises as `record` does."""
        done = self.last(job_id).step
        self._append(
            job_id, [{"state": "running", "step": row.step, "metrics": row.metrics} for row in rows if row.step > done]
        )

    def last(self, job_id: str) -> JobEvent:
        """Returns the last event of a job. Raises NotFound when there is no such job."""
        with self._deleted_is_not_found():
            return _event(last_document(self.folder(job_id) / "events.jsonl") or {})

    def events(self, job_id: str) -> Callable[[], list[JobEvent]]:
        """Returns a function whose every call returns the events that are new since the last one; at first, all."""
        reader = self._reader(job_id)
        return lambda: [_event(document) for document in reader.read()]

    async def watch(
        self,
        job_id: str,
        *,
        from_sequence: int,
        pause: Callable[[bool], Awaitable[bool]],
        threads: Executor | None = None,
    ) -> AsyncIterator[tuple[int, dict[str, Any]]]:
        """Yields sequence numbers and the fields of a job after each event; ends after the event that ends the job.

        A watcher is only a position in a file: however slow it is, the job does not wait for it. `pause` is awaited
        while there is no new event, with whether there was one since the last pause; it returns False to end the
        stream. Files are read on `threads`, by default the default executor of the event loop.

        Raises NotFound when there is no such job, or no longer.
        """
        run = partial(asyncio.get_running_loop().run_in_executor, threads)
        config, reader = await run(self.config, job_id), self._reader(job_id)
        sequence = await run(reader.skip, max(0, from_sequence - 1))  # the one before tells whether the job has ended
        ended = is_new = False
        while True:
            while new := await run(reader.read):
                is_new = True
                for event in map(_event, new):
                    ended = event.ended
                    if sequence >= from_sequence:
                        model = await run(self._model, job_id) if event.state == "succeeded" else None
                        yield sequence, {"id": job_id, **config, **vars(event), "model": model}
                    sequence += 1
            if ended or not await pause(is_new):
                return
            await run(self.check, job_id)
            is_new = False

    def fields(self, job_id: str, event: JobEvent | None = None) -> dict[str, Any]:
        """Returns the fields of `Fit` and `Run` after an event, by default the last; raises NotFound as `config`."""
        folder = self.folder(job_id)
        with self._deleted_is_not_found():
            (folder / "request.json").stat()
            config = json.loads((folder / "config.json").read_bytes())
        event = event or self.last(job_id)
        model = self._model(job_id) if event.state == "succeeded" else None
        return {"id": job_id, **config, **vars(event), "model": model}

    def metrics(self, request: JobMetricsRequest) -> JobMetrics:
        """Returns a job's metrics, decimated to `max_rows`.

        Raises NotFound when there is no such job, InvalidInput when `max_rows` is too large.
        """
        most = _bounded(request.max_rows, default=_ROWS, most=_MAX_ROWS, field="max_rows")
        self.check(request.id)
        path = self.folder(request.id) / "metrics.jsonl"
        with self._deleted_is_not_found():
            return read_metrics(path, from_step=request.from_step, max_rows=most, keep_extremes=request.keep_extremes)

    def set_model(self, job_id: str, model: ModelRef) -> None:
        """Records durably the model that a job has made."""
        write_atomic(self.folder(job_id) / "model.json", json.dumps(vars(model)).encode())

    def artifacts(self, job_id: str) -> tuple[Artifact, ...]:
        """Returns the artifacts of a job, by name. Raises NotFound when there is no such job."""
        self.check(job_id)
        files = sorted((self.folder(job_id) / "artifacts").glob("[!.]*"))
        with self._deleted_is_not_found():
            found = [(path.name, path.stat()) for path in files if path.is_file()]
            return tuple(Artifact(name, stat.st_size, stat.st_mtime_ns) for name, stat in found)

    def artifact(self, job_id: str, name: str) -> Path:
        """Returns the path of an artifact. Raises NotFound when there is no such job or artifact."""
        self.check(job_id)
        path = self.folder(job_id) / "artifacts" / check_name(name, field="name")
        if not path.is_file():
            raise NotFound(f"The {self.noun} has no artifact of this name.", field="name", hint="List its artifacts.")
        return path

    def _name(self, config: Mapping[str, Any]) -> str:
        """Returns the readable name of a job; that of a fit is of its service, whose folder this is."""
        return job_name(config["kind"], config["config"]) if "kind" in config else job_name(self._root.name, config)

    def _reader(self, job_id: str) -> LineReader:
        return LineReader(self.folder(job_id) / "events.jsonl")

    def _model(self, job_id: str) -> ModelRef | None:
        with suppress(FileNotFoundError):
            return ModelRef(**json.loads((self.folder(job_id) / "model.json").read_bytes()))
        return None

    @contextmanager
    def lock(self, job_id: str) -> Iterator[None]:
        """Excludes other processes while it is decided whether a job has ended or is queued again.

        Raises NotFound when there is no such job.
        """
        with self._deleted_is_not_found(), locked(self.folder(job_id) / "state.lock"):
            yield

    def _append(self, job_id: str, changes: Sequence[Mapping[str, Any]]) -> None:
        def documents(last: Mapping[str, Any] | None) -> Iterator[Mapping[str, Any]]:
            before = last or vars(JobEvent())
            for change in changes:
                after = {**before, "error": "", **change}
                if after != before and (before["state"] not in ENDED or after["state"] == "queued"):
                    before = self._now(after)
                    yield before

        self.check(job_id)
        with self._deleted_is_not_found():
            append(self.folder(job_id) / "events.jsonl", documents)

    def _now(self, event: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the document of an event that happens now."""
        return {**vars(JobEvent()), **event, "time_ns": self._clock_ns()}

    def _is_unfinished(self, job_id: str) -> bool:
        try:
            return not self.last(job_id).ended
        except (NotFound, ValueError, TypeError):
            _log.warning("a job is left out, for files of its folder are missing or damaged", extra={"job": job_id})
            return False

    def _not_found(self) -> NotFound:
        return NotFound(
            f"There is no {self.noun} of this id.", field="id", hint=f"GET /v1/list-{self.noun}s lists them."
        )

    @contextmanager
    def _deleted_is_not_found(self) -> Iterator[None]:
        try:
            yield
        except FileNotFoundError:
            raise self._not_found() from None

    def _newest_first(self) -> dict[tuple[int, str], int]:
        """Returns the sizes in bytes of the configurations of all jobs, by their times in nanoseconds and ids."""
        found = {}
        for path in self._root.glob("[0-9a-f]" * 32 + "/config.json"):
            with suppress(FileNotFoundError):  # deleted meanwhile
                stat = path.stat()
                found[stat.st_mtime_ns, path.parent.name] = stat.st_size
        return dict(sorted(found.items(), reverse=True))


def id_of(idempotency_key: str) -> str:
    """Returns the id of the job that is started with an idempotency key."""
    return uuid.uuid5(_KEYS, idempotency_key).hex


def _place(page_token: str) -> tuple[int, str]:
    """Returns the time in nanoseconds and the id of the last job of a page."""
    found = re.fullmatch("([0-9]{1,19})-([0-9a-f]{32})", page_token)
    if found is None:
        raise InvalidInput(
            "`page_token` must be the `next_page_token` of an earlier reply; this one is unknown.",
            field="page_token",
            hint="Leave it out to start from the first page.",
        )
    return int(found[1]), found[2]


def _event(document: Mapping[str, Any]) -> JobEvent:
    return JobEvent(**{name: value for name, value in document.items() if name in JobEvent.__annotations__})


def _bounded(value: int, *, default: int, most: int, field: str) -> int:
    if not 0 <= value <= most:
        raise must_be(field, f"at most {most}", value, hint=f"Leave it out for {default}.")
    return value or default
