"""What the orchestrator answers about runs: start, get, list, watch, cancel, resume."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from typing import Any

from freerein.errors import FailedPrecondition
from freerein.serving.health import Health
from freerein.types.common import check_name
from freerein_orchestrator.durable import DurableRuns
from freerein_orchestrator.outcomes import ENDED, RunState
from freerein_orchestrator.runs.records import RunEvent, RunRecords, RunRequest

_LOOK_S = 0.2
_UNSAID = "A bug of ours; the log says more."

Resolve = Callable[[str, Mapping[str, Any]], dict[str, Any]]


@dataclass(frozen=True)
class Run:
    """A run as it stands.

    Attributes:
        id: 32 hexadecimal digits.
        kind: Its kind.
        config: The whole configuration, defaults filled in.
        last: Its last event, whose sequence is not counted here.
    """

    id: str
    kind: str
    config: dict[str, Any]
    last: RunEvent


class Runs:
    """The runs of one data directory and database.

    Args:
        records: What is on disk.
        durable: What is in the database.
        resolve: Returns the whole configuration for a kind and a partial one; raises InvalidInput for what cannot be.
        health: Ends the streams of `watch` on drain.
    """

    def __init__(self, records: RunRecords, durable: DurableRuns, *, resolve: Resolve, health: Health) -> None:
        self._records = records
        self._durable = durable
        self._resolve = resolve
        self._health = health

    async def open(self) -> None:
        """Goes on with what had not ended. Raises FailedPrecondition when a worker of this name is running."""
        await asyncio.to_thread(self._durable.open)
        await self.list()

    async def close(self) -> None:
        """Stops the child, which saves first; the next start goes on with its run."""
        await asyncio.to_thread(self._durable.close)

    async def start(self, request: RunRequest) -> Run:
        """Queues a run, or returns the one that this idempotency key has started already.

        Raises:
            InvalidInput: The configuration is wrong.
            AlreadyExists: The idempotency key belongs to another request.
        """
        if request.idempotency_key:
            check_name(request.idempotency_key, field="idempotency_key")
        config = self._resolve(request.kind, request.config)

        def start() -> Run:
            run_id = self._records.add(request, config)
            self._durable.start(run_id)
            return self._standing(run_id, self._durable.state(run_id))

        return await asyncio.to_thread(start)

    async def get(self, run_id: str) -> Run:
        """Returns one run. Raises NotFound when there is none of that id."""
        return await asyncio.to_thread(lambda: self._standing(run_id, self._state(run_id)))

    async def list(self) -> tuple[Run, ...]:
        """Returns all runs, newest first, without those whose folders were deleted."""

        def standings() -> tuple[Run, ...]:
            states = self._durable.states().items()
            return tuple(self._standing(run_id, state) for run_id, state in states if self._records.has(run_id))

        return await asyncio.to_thread(standings)

    async def watch(self, run_id: str, from_sequence: int = 0) -> AsyncIterator[RunEvent]:
        """Yields a run's events from a sequence number on; ends when the run has ended, or on drain.

        Raises:
            NotFound: There is none of that id.
        """
        await self.get(run_id)
        tail, last = self._records.watch(run_id), None
        while True:
            for event in await asyncio.to_thread(tail.read):
                last = event
                if event.sequence >= from_sequence:
                    yield event
            if last is not None and last.ended:
                return
            if await self._health.unless_draining(asyncio.sleep(_LOOK_S, True)) is None:
                return

    async def cancel(self, run_id: str) -> Run:
        """Ends a run that has not ended; its last checkpoint stays. Raises NotFound when there is none of that id."""

        def cancel() -> Run:
            self._records.folder(run_id)
            return self._standing(run_id, self._durable.cancel(run_id))

        return await asyncio.to_thread(cancel)

    async def resume(self, run_id: str) -> Run:
        """Queues a run again that failed or was cancelled; it goes on from its last checkpoint.

        Raises:
            NotFound: There is none of that id.
            FailedPrecondition: It did neither.
        """

        def resume() -> Run:
            state = self._standing(run_id, self._state(run_id)).last.state
            if state not in ("failed", "cancelled"):
                raise FailedPrecondition(
                    f"A run to resume must be failed or cancelled; this one is {state}.",
                    field="id",
                    hint="Start a new run, or cancel this one first.",
                )
            self._records.note(run_id, "queued")  # before its worker notes that it runs
            self._durable.resume(run_id)
            return self._standing(run_id, self._durable.state(run_id))

        return await asyncio.to_thread(resume)

    def _state(self, run_id: str) -> RunState:
        self._records.folder(run_id)  # refuses what is no id
        return self._durable.state(run_id)

    def _standing(self, run_id: str, state: RunState) -> Run:
        """Returns a run, and notes an end that a crash kept from being noted."""
        config = self._records.config(run_id)
        if state in ENDED:
            self._records.note(run_id, state, reason=_UNSAID if state == "failed" else "")
        return Run(run_id, config["kind"], config["config"], self._records.last(run_id))
