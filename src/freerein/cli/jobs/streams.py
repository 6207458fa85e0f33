"""Streams that survive a restart of their service, such as the events of a fit or run."""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from typing import TypeVar

from freerein.clients import FitClient, OrchestratorClient
from freerein.errors import Unavailable, WorkerLost
from freerein.types.learning import Fit, WatchFitRequest, WatchFitResponse
from freerein.types.orchestrator import Run, WatchRunRequest, WatchRunResponse

T = TypeVar("T")
E = TypeVar("E", WatchFitResponse, WatchRunResponse)
J = TypeVar("J", Fit, Run)

TIMEOUT_S = 30.0
_RETRY_S = 0.5


def follow_fit(client: FitClient, fit_id: str) -> AsyncGenerator[Fit, None]:
    """Yields a fit after each change, from the first to the last."""
    return _follow(lambda start: client.watch_fit(WatchFitRequest(fit_id, start)), lambda event: event.fit)


def follow_run(client: OrchestratorClient, run_id: str) -> AsyncGenerator[Run, None]:
    """As `follow_fit`, for a run. A run that was resumed has ended before its last state."""
    return _follow(lambda start: client.watch_run(WatchRunRequest(run_id, start)), lambda event: event.run)


async def reconnecting(
    open_stream: Callable[[], AsyncGenerator[T, None]], *, timeout_s: float = TIMEOUT_S
) -> AsyncGenerator[T, None]:
    """Yields the items of a stream, which is opened again where it broke off when the service goes away.

    Raises Unavailable or WorkerLost once the service has been unreachable for `timeout_s`. A stream that was open for
    longer than that counts as reachable, however quiet.
    """
    last_seen_s = time.monotonic()
    while True:
        opened_s = time.monotonic()
        try:
            async with aclosing(open_stream()) as items:
                async for item in items:
                    last_seen_s = time.monotonic()
                    yield item
            return
        except (Unavailable, WorkerLost):
            broken_s = time.monotonic()
            if broken_s - opened_s > timeout_s:
                last_seen_s = broken_s
            if broken_s - last_seen_s > timeout_s:
                raise
            await asyncio.sleep(_RETRY_S)


async def _follow(watch: Callable[[int], AsyncGenerator[E, None]], job_of: Callable[[E], J]) -> AsyncGenerator[J, None]:
    """Yields the jobs of the events that `watch` opens from a sequence number on."""
    seen, has_ended = -1, False

    async def remaining() -> AsyncGenerator[E, None]:
        async with aclosing(watch(seen + 1)) as events:
            async for event in events:
                yield event
        if not has_ended:
            raise Unavailable("The stream of events must last to the end; it broke off.", hint="Watch it again.")

    async with aclosing(reconnecting(remaining)) as events:
        async for event in events:
            job = job_of(event)
            seen, has_ended = event.sequence, job.ended
            yield job
