"""`RunService`: the core of the orchestrator. What happened to a run survives every process.

A request is on disk before its run is queued in the database, and acknowledged after. The state in the database takes
precedence over the events on disk: a difference, left by a crash or a full disk, is repaired when the run is next read.
A success is the exception: on disk it is final, though the database hears of it a moment later.
"""

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar

from freerein.atomic_files import storage_errors
from freerein.errors import (
    AlreadyExists,
    FailedPrecondition,
    NotFound,
    OutOfStorage,
    Overloaded,
    ServiceError,
    Unavailable,
)
from freerein.jobs.store import JobStore, id_of
from freerein.serving.health import Health
from freerein.types import orchestrator
from freerein.types.common import check_name
from freerein.types.jobs import ENDED, JobState
from freerein_orchestrator.runs.dbos_queue import DbosQueue

_log = logging.getLogger(__name__)
_POLL_S = 0.2
_SILENCE_S = 3.0
_SETTLE_S = 2.0
_REOPEN_S = 1.0
_MAX_WAITING = 256
_PART_BYTES = 1 << 20
_THREADS = 4
_TRAIN_ON = "`freerein jobs resume ID --iterations N` trains a ppo run on, as a new run with `resume_from`."

T = TypeVar("T")


@dataclass(frozen=True)
class Resolved:
    """A resolved request.

    Attributes:
        config: Configuration, with defaults filled in.
        steps: Steps planned.
    """

    config: dict[str, Any]
    steps: int


Resolve = Callable[[str, Mapping[str, Any]], Resolved]


class RunService:
    """The runs of one data directory and database.

    Args:
        store: The runs on disk.
        queue: The runs in the database.
        resolve: Returns the resolved request for a kind and a partial configuration; raises InvalidInput.
        health: Ends the streams of `watch_run` on drain.
        truth: Returns the privileged data that a run of a kind and configuration reads; empty for none.
        check_unused: Raises FailedPrecondition where a run, by its id, must not be deleted, for another builds on it.
    """

    def __init__(
        self,
        store: JobStore,
        queue: DbosQueue,
        *,
        resolve: Resolve,
        health: Health,
        truth: Callable[[str, Mapping[str, Any]], str] = lambda _kind, _config: "",
        check_unused: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._store = store
        self._truth = truth
        self._check_unused = check_unused
        self._queue = queue
        self._resolve = resolve
        self._health = health
        self._threads = ThreadPoolExecutor(_THREADS, "runs")  # only these wait for the database
        self._reason = "The database of the runs is being opened."

    def not_ready(self) -> str:
        """Returns why runs cannot be started yet, empty when they can."""
        return self._reason

    async def start(self) -> None:
        """Resumes the runs that had not ended; waits for the database, and room on its disk, as long as it takes.

        Raises FailedPrecondition when a worker of this name is running.
        """
        while not self._health.draining:
            try:
                with storage_errors():
                    await self._in_thread(self._queue.open)
            except (Unavailable, OutOfStorage) as error:
                self._reason = f"{error.detail} {error.hint}"
                await self._health.await_or_drain(asyncio.sleep(_REOPEN_S))
                continue
            self._reason = ""
            with suppress(ServiceError):  # the database is away again, or another worker has deleted one
                await self._in_thread(self._queue_unknown)
            await self._record_ends()
            return

    async def close(self) -> None:
        """Stops the child process, which may save first; the next start resumes its run."""
        await asyncio.to_thread(self._queue.close)
        self._threads.shutdown(wait=False, cancel_futures=True)

    def _queue_unknown(self) -> None:
        """Queues the runs that a crash kept from the database, before anybody was told of them."""
        unfinished = self._store.unfinished()
        known = self._queue.states(unfinished)
        for run_id in unfinished:
            if run_id not in known and self._store.last(run_id).state == "queued":
                self._queue.start(run_id)

    async def _record_ends(self) -> None:
        """Reads every run, which records the ends that no worker could."""
        token = ""
        with suppress(Unavailable, OutOfStorage):
            while True:
                token = (await self.list_runs(orchestrator.ListRunsRequest(page_token=token))).next_page_token
                if not token:
                    return

    async def start_run(self, request: orchestrator.StartRunRequest) -> orchestrator.StartRunResponse:
        """Queues a run, or returns the one that this idempotency key has started already.

        Raises:
            InvalidInput: The configuration is wrong.
            AlreadyExists: The idempotency key was used for another request, or for a run that was deleted.
            Overloaded: Too many runs are waiting.
            Unavailable: The database of the runs is out of reach.
            OutOfStorage: The disk is full, broken or read-only.
        """
        self._check_open()
        if request.idempotency_key:
            check_name(request.idempotency_key, field="idempotency_key")

        def start() -> orchestrator.Run:
            run_id = self._store.find(vars(request)) or self._create(request)
            try:
                self._queue.start(run_id)
            except (Unavailable, OutOfStorage):
                if not request.idempotency_key:  # by which the same call would start it
                    with suppress(ServiceError, OSError):
                        self._store.delete(run_id)
                raise
            return self._run(run_id)

        return orchestrator.StartRunResponse(await self._in_thread(start))

    async def get_run(self, request: orchestrator.GetRunRequest) -> orchestrator.GetRunResponse:
        """Returns one run. Raises NotFound when there is no such run."""
        return orchestrator.GetRunResponse(await self._in_thread(lambda: self._run(request.id)))

    async def list_runs(self, request: orchestrator.ListRunsRequest) -> orchestrator.ListRunsResponse:
        """Returns one page of the runs, newest first, without those whose folders were deleted, or in part."""
        self._check_open()

        def page() -> orchestrator.ListRunsResponse:
            ids, token = self._store.page(request.page_size, request.page_token)
            states, runs = self._queue.states(ids), []
            for run_id in filter(states.__contains__, ids):
                try:
                    runs.append(self._run_in(states[run_id], run_id))
                except NotFound:
                    _log.warning("a run is left out, for files of its folder are missing", extra={"run": run_id})
            return orchestrator.ListRunsResponse(tuple(runs), token)

        return await self._in_thread(page)

    async def watch_run(self, request: orchestrator.WatchRunRequest) -> AsyncIterator[orchestrator.WatchRunResponse]:
        """Yields the events of a run from a sequence number on; ends with the run, or on drain.

        Raises NotFound when there is no such run.
        """
        await self._in_thread(lambda: self._run(request.id))
        clock = asyncio.get_running_loop().time
        heard_s, checking = clock(), None

        async def pause(is_new: bool) -> bool:
            nonlocal heard_s, checking
            if is_new:
                heard_s = clock()
            elif clock() > heard_s + _SILENCE_S and (checking is None or checking.done()):
                heard_s, checking = clock(), self._in_thread(lambda: self._try_to_repair(request.id))
            return await self._health.await_or_drain(asyncio.sleep(_POLL_S, True)) is not None

        async for sequence, fields in self._store.watch(request.id, from_sequence=request.from_sequence, pause=pause):
            yield orchestrator.WatchRunResponse(sequence, self._of_fields(fields))

    async def get_metrics(self, request: orchestrator.GetMetricsRequest) -> orchestrator.GetMetricsResponse:
        """Returns the metrics of a run from a step on, decimated. Raises NotFound when there is no such run."""
        found = await asyncio.to_thread(self._store.metrics, request)
        return orchestrator.GetMetricsResponse(**vars(found))

    async def cancel_run(self, request: orchestrator.CancelRunRequest) -> orchestrator.CancelRunResponse:
        """Cancels a run that has not ended; its last checkpoint is kept. Raises NotFound when there is no such run."""
        self._check_open()

        def cancel() -> orchestrator.Run:
            self._store.check(request.id)
            with self._store.lock(request.id):
                if self._settled_state(request.id) not in ENDED:
                    self._queue.cancel(request.id)
            return self._run(request.id)

        return orchestrator.CancelRunResponse(await self._in_thread(cancel))

    async def resume_run(self, request: orchestrator.ResumeRunRequest) -> orchestrator.ResumeRunResponse:
        """Queues a failed or cancelled run again; it resumes from its last checkpoint.

        Raises NotFound when there is no such run, FailedPrecondition when it is neither failed nor cancelled.
        """

        def resume() -> orchestrator.Run:
            self._run(request.id)
            with self._store.lock(request.id):
                state = self._settled_state(request.id)
                if state not in ("failed", "cancelled"):
                    raise FailedPrecondition(
                        f"A run to resume must be failed or cancelled; this one is {state}.",
                        field="id",
                        hint=_TRAIN_ON if state == "succeeded" else "Watch it, or cancel it first.",
                    )
                self._store.record(request.id, "queued")  # before its worker records that it runs
                self._queue.resume(request.id)
            return self._run(request.id)

        return orchestrator.ResumeRunResponse(await self._in_thread(resume))

    async def delete_run(self, request: orchestrator.DeleteRunRequest) -> orchestrator.DeleteRunResponse:
        """Deletes a run that has ended; its idempotency key is free again.

        Where the database was away after the folder was deleted, the next call makes it forget the run.

        Raises:
            NotFound: There is no such run, or no longer.
            FailedPrecondition: The run has not ended, or one that has not ended builds on it.
            Overloaded: Its child process has not ended yet.
        """

        def delete() -> None:
            try:
                self._run(request.id)
            except NotFound:
                if self._queue.states([request.id]).get(request.id) in ENDED:
                    self._queue.delete(request.id)
                raise
            self._check_unused(request.id)
            with self._store.lock(request.id):
                state = self._database_state(request.id)
                if state not in ENDED:
                    raise self._store.not_ended(request.id, state)
                self._store.delete(request.id)
            self._queue.delete(request.id)

        await self._in_thread(delete)
        return orchestrator.DeleteRunResponse()

    async def list_artifacts(self, request: orchestrator.ListArtifactsRequest) -> orchestrator.ListArtifactsResponse:
        """Lists the artifacts of a run. Raises NotFound when there is no such run."""
        return orchestrator.ListArtifactsResponse(await asyncio.to_thread(self._store.artifacts, request.id))

    async def get_artifact(
        self, request: orchestrator.GetArtifactRequest
    ) -> AsyncIterator[orchestrator.GetArtifactResponse]:
        """Yields the parts of one artifact, at least one. Raises NotFound when there is no such run or artifact."""
        with await asyncio.to_thread(lambda: self._store.artifact(request.id, request.name).open("rb")) as file:
            part = await asyncio.to_thread(file.read, _PART_BYTES)
            yield orchestrator.GetArtifactResponse(part)
            while part := await asyncio.to_thread(file.read, _PART_BYTES):
                yield orchestrator.GetArtifactResponse(part)

    def _check_open(self) -> None:
        if self._reason:
            raise Unavailable(
                f"The database of the runs must be open; it is not: {self._reason}",
                hint="Try again in a moment; /readyz says when.",
                retry_after_s=1.0,
            )

    def _in_thread(self, call: Callable[[], T]) -> "asyncio.Future[T]":
        return asyncio.get_running_loop().run_in_executor(self._threads, call)

    def _create(self, request: orchestrator.StartRunRequest) -> str:
        key = request.idempotency_key
        if key and self._queue.states([id_of(key)]) and not self._store.find(vars(request)):  # nor made meanwhile
            raise AlreadyExists(
                "An idempotency key must be used for one run; the run of this one was deleted.",
                field="idempotency_key",
                hint="Choose a new key.",
            )
        resolved = self._resolve(request.kind, request.config)
        if self._queue.count_queued(limit=_MAX_WAITING) >= _MAX_WAITING:
            raise Overloaded(f"At most {_MAX_WAITING} runs may wait.", hint="Cancel one, or wait for one to end.")
        return self._store.create(vars(request), {"kind": request.kind, **vars(resolved)})

    def _run(self, run_id: str) -> orchestrator.Run:
        self._check_open()
        self._store.config(run_id)
        return self._run_in(self._queue.status(run_id).state, run_id)

    def _run_in(self, state: JobState, run_id: str) -> orchestrator.Run:
        """Returns a run whose state in the database is given; records first an end that is not recorded on disk."""
        event = self._store.last(run_id)
        if state in ENDED and state != event.state:
            self._record_end(run_id)
            event = self._store.last(run_id)
        return self._of_fields(self._store.fields(run_id, event))

    def _of_fields(self, fields: Mapping[str, Any]) -> orchestrator.Run:
        return orchestrator.Run(**fields, truth=self._truth(fields["kind"], fields["config"]))

    def _record_end(self, run_id: str) -> None:
        try:
            with self._store.lock(run_id):  # the run may be resumed meanwhile
                status = self._queue.status(run_id)
                if status.state in ENDED:
                    self._store.record(run_id, status.state, error=status.error)
        except OSError:  # a full disk; the next call tries again
            _log.warning("the end of a run cannot be recorded", extra={"run": run_id})

    def _settled_state(self, run_id: str) -> JobState:
        """Returns the state in the database, unless the run has succeeded: that is final."""
        is_final = self._store.last(run_id).state == "succeeded"
        return "succeeded" if is_final else self._database_state(run_id)

    def _database_state(self, run_id: str) -> JobState:
        """Returns the state in the database, which hears of an end a moment after the events on disk."""
        deadline = time.monotonic() + _SETTLE_S
        while True:
            state = self._queue.status(run_id).state
            if state in ENDED or not self._store.last(run_id).ended or time.monotonic() > deadline:
                return state
            time.sleep(_POLL_S / 4)

    def _try_to_repair(self, run_id: str) -> None:
        with suppress(ServiceError):
            self._run(run_id)
