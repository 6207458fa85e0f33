"""`Runs`: the core of the orchestrator. Started, watched, cancelled, resumed; what happened survives every process.

A request is on disk before its run is queued in the database, and acknowledged after. What the database says of a run
wins over what its events say: a crash or a full disk in between is mended when the run is next looked at.
"""

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from freerein.errors import FailedPrecondition, Overloaded, ServiceError, Unavailable
from freerein.serving.health import Health
from freerein.types.common import check_name
from freerein.types.orchestrator import (
    ENDED,
    CancelRunRequest,
    CancelRunResponse,
    GetArtifactRequest,
    GetArtifactResponse,
    GetRunRequest,
    GetRunResponse,
    ListArtifactsRequest,
    ListArtifactsResponse,
    ListRunsRequest,
    ListRunsResponse,
    ResumeRunRequest,
    ResumeRunResponse,
    Run,
    RunKind,
    RunState,
    StartRunRequest,
    StartRunResponse,
    WatchRunRequest,
    WatchRunResponse,
)
from freerein_orchestrator.durable import DurableRuns
from freerein_orchestrator.runs.records import RunEvent, RunRecords

_log = logging.getLogger(__name__)
_LOOK_S = 0.2
_SILENCE_S = 3.0
_SETTLES_S = 2.0
_WAITING = 256
_PART_BYTES = 1 << 20
_THREADS = 4

T = TypeVar("T")


@dataclass(frozen=True)
class Resolved:
    """What a run is to be.

    Attributes:
        config: The whole configuration, defaults filled in.
        steps: How many steps it takes.
    """

    config: dict[str, Any]
    steps: int


Resolve = Callable[[RunKind, Mapping[str, Any]], Resolved]


class Runs:
    """The runs of one data directory and database.

    Args:
        records: What is on disk.
        durable: What is in the database.
        resolve: Returns what a run of a kind and a partial configuration is; raises InvalidInput for what cannot be.
        health: Ends the streams of `watch_run` on drain.
    """

    def __init__(self, records: RunRecords, durable: DurableRuns, *, resolve: Resolve, health: Health) -> None:
        self._records = records
        self._durable = durable
        self._resolve = resolve
        self._health = health
        self._threads = ThreadPoolExecutor(_THREADS, "runs")  # what waits for the database keeps nothing else waiting
        self._reason = "The database of the runs is being opened."

    def not_ready(self) -> str:
        """Returns why runs cannot be started yet, empty when they can."""
        return self._reason

    async def start(self) -> None:
        """Goes on with what had not ended; waits for the database as long as it takes.

        Raises:
            FailedPrecondition: A worker of this name is running.
        """
        while not self._health.draining:
            try:
                await self._in_thread(self._durable.open)
            except Unavailable as away:
                self._reason = f"{away.detail} {away.hint}"
                continue
            self._reason = ""
            with suppress(Unavailable):
                await self.list_runs(ListRunsRequest())
            return

    async def close(self) -> None:
        """Stops the child, which may save first; the next start goes on with its run."""
        await asyncio.to_thread(self._durable.close)
        self._threads.shutdown(wait=False, cancel_futures=True)

    async def start_run(self, request: StartRunRequest) -> StartRunResponse:
        """Queues a run, or returns the one that this idempotency key has started already.

        Raises:
            InvalidInput: The configuration is wrong.
            AlreadyExists: The idempotency key belongs to another request.
            Overloaded: Too many runs wait already.
            Unavailable: The database of the runs cannot be reached.
        """
        self._check_open()
        if request.idempotency_key:
            check_name(request.idempotency_key, field="idempotency_key")

        def start() -> Run:
            run_id = self._records.started_by(request) or self._add(request)
            self._durable.start(run_id)
            return self._look(run_id)

        return StartRunResponse(await self._in_thread(start))

    async def get_run(self, request: GetRunRequest) -> GetRunResponse:
        """Returns one run. Raises NotFound when there is none of that id."""
        return GetRunResponse(await self._in_thread(lambda: self._look(request.id)))

    async def list_runs(self, _request: ListRunsRequest) -> ListRunsResponse:
        """Returns all runs, newest first, without those whose folders were deleted."""
        self._check_open()

        def standings() -> tuple[Run, ...]:
            states = self._durable.states().items()
            return tuple(self._standing(run_id, state) for run_id, state in states if self._records.has(run_id))

        return ListRunsResponse(await self._in_thread(standings))

    async def watch_run(self, request: WatchRunRequest) -> AsyncIterator[WatchRunResponse]:
        """Yields a run's events from a sequence number on; ends when the run has ended, or on drain.

        Nothing is kept for a watcher but its place in a file: however slow it is, the run does not wait for it.

        Raises:
            NotFound: There is none of that id.
        """
        run = await self._in_thread(lambda: self._look(request.id))
        tail, last, clock = self._records.watch(request.id), None, asyncio.get_running_loop().time
        heard_s, looking = clock(), None
        while True:
            for event in await asyncio.to_thread(tail.read):
                last, heard_s = event, clock()
                if event.sequence >= request.from_sequence:
                    yield WatchRunResponse(event.sequence, self._as_of(event, run))
            if last is not None and last.ended:
                return
            if clock() > heard_s + _SILENCE_S and (looking is None or looking.done()):
                heard_s, looking = clock(), self._in_thread(lambda: self._try_to_look(request.id))
            if await self._health.await_or_drain(asyncio.sleep(_LOOK_S, True)) is None:
                return

    async def cancel_run(self, request: CancelRunRequest) -> CancelRunResponse:
        """Ends a run that has not ended; its last checkpoint stays. Raises NotFound when there is none of that id."""
        self._check_open()

        def cancel() -> Run:
            self._records.config(request.id)
            self._durable.cancel(request.id)
            return self._look(request.id)

        return CancelRunResponse(await self._in_thread(cancel))

    async def resume_run(self, request: ResumeRunRequest) -> ResumeRunResponse:
        """Queues a run again that failed or was cancelled; it goes on from its last checkpoint.

        Raises:
            NotFound: There is none of that id.
            FailedPrecondition: It did neither.
        """

        def resume() -> Run:
            self._look(request.id)
            with self._records.settling(request.id):
                state = self._settled(request.id)
                if state not in ("failed", "cancelled"):
                    raise FailedPrecondition(
                        f"A run to resume must be failed or cancelled; this one is {state}.",
                        field="id",
                        hint="Start a new run, or cancel this one first.",
                    )
                self._records.note(request.id, "queued")  # before its worker notes that it runs
                self._durable.resume(request.id)
            return self._look(request.id)

        return ResumeRunResponse(await self._in_thread(resume))

    async def list_artifacts(self, request: ListArtifactsRequest) -> ListArtifactsResponse:
        """Names the files that a run has left behind. Raises NotFound when there is none of that id."""

        def found() -> ListArtifactsResponse:
            self._records.config(request.id)
            return ListArtifactsResponse(self._records.artifacts(request.id))

        return await asyncio.to_thread(found)

    async def get_artifact(self, request: GetArtifactRequest) -> AsyncIterator[GetArtifactResponse]:
        """Yields the parts of one file, at least one.

        Raises:
            NotFound: There is no such run, or it has no file of that name.
        """

        def opened() -> Any:
            self._records.config(request.id)
            return self._records.artifact(request.id, request.name).open("rb")

        with await asyncio.to_thread(opened) as file:
            part = await asyncio.to_thread(file.read, _PART_BYTES)
            yield GetArtifactResponse(part)
            while part := await asyncio.to_thread(file.read, _PART_BYTES):
                yield GetArtifactResponse(part)

    def _check_open(self) -> None:
        if self._reason:
            raise Unavailable(
                f"Runs are in a database, which must be open; it is not: {self._reason}",
                hint="Try again in a moment; /readyz says when.",
                retry_after_s=1.0,
            )

    def _in_thread(self, work: Callable[[], T]) -> "asyncio.Future[T]":
        return asyncio.get_running_loop().run_in_executor(self._threads, work)

    def _add(self, request: StartRunRequest) -> str:
        asked = self._resolve(request.kind, request.config)
        if self._durable.count_queued(limit=_WAITING) >= _WAITING:
            raise Overloaded(f"At most {_WAITING} runs may wait; they do.", hint="Cancel one, or wait for one to end.")
        return self._records.add(request, asked.config, steps=asked.steps)

    def _look(self, run_id: str) -> Run:
        self._check_open()
        self._records.config(run_id)
        return self._standing(run_id, self._durable.standing(run_id).state)

    def _settled(self, run_id: str) -> RunState:
        """Returns where the database says that a run stands, which has an end a moment after the events have it."""
        began = time.monotonic()
        while True:
            state = self._durable.standing(run_id).state
            late = state not in ENDED and self._records.last(run_id).ended
            if not late or time.monotonic() > began + _SETTLES_S:
                return state
            time.sleep(_LOOK_S / 4)

    def _try_to_look(self, run_id: str) -> None:
        """Notes an end that was not noted when it came."""
        with suppress(ServiceError):
            self._look(run_id)

    def _standing(self, run_id: str, state: RunState) -> Run:
        """Returns a run; notes first an end that was not noted when it came."""
        asked, event = self._records.config(run_id), self._records.last(run_id)
        if state in ENDED and state != event.state:
            self._note_end(run_id)
            event = self._records.last(run_id)
        run = Run(run_id, asked["kind"], "queued", asked["config"], steps=asked["steps"])
        return self._as_of(event, run)

    def _note_end(self, run_id: str) -> None:
        try:
            with self._records.settling(run_id):  # a run that is resumed meanwhile has not ended
                found = self._durable.standing(run_id)
                if found.state in ENDED:
                    self._records.note(run_id, found.state, reason=found.reason)
        except OSError:  # a full disk; the next look tries again
            _log.warning("the end of a run cannot be noted", extra={"run": run_id})

    def _as_of(self, event: RunEvent, run: Run) -> Run:
        """Returns a run as it stood at an event."""
        model = self._records.model(run.id) if event.state == "succeeded" else None
        return replace(run, state=event.state, step=event.step, metrics=event.metrics, model=model, error=event.reason)
