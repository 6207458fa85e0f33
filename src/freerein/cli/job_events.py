"""Watches a fit or a run to its end, through restarts of its service."""

from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from typing import TypeVar

from freerein.cli.streams import reconnecting
from freerein.clients import FitClient, OrchestratorClient
from freerein.errors import Unavailable
from freerein.types.learning import Fit, WatchFitRequest, WatchFitResponse
from freerein.types.orchestrator import Run, WatchRunRequest, WatchRunResponse

E = TypeVar("E", WatchFitResponse, WatchRunResponse)
J = TypeVar("J", Fit, Run)


def follow_fit(client: FitClient, fit_id: str) -> AsyncGenerator[Fit, None]:
    """Yields a fit after each change, from the first to the last.

    Raises ServiceError when there is no such fit, or the service is gone.
    """
    return _follow(lambda start: client.watch_fit(WatchFitRequest(fit_id, start)), lambda event: event.fit)


def follow_run(client: OrchestratorClient, run_id: str) -> AsyncGenerator[Run, None]:
    """Yields a run after each change, from the first to the last. A run that was resumed has ended before.

    Raises ServiceError when there is no such run, or the orchestrator is gone.
    """
    return _follow(lambda start: client.watch_run(WatchRunRequest(run_id, start)), lambda event: event.run)


async def _follow(watch: Callable[[int], AsyncGenerator[E, None]], job_of: Callable[[E], J]) -> AsyncGenerator[J, None]:
    """Yields the jobs of events.

    Args:
        watch: Opens the stream of events from a sequence number on.
        job_of: Returns the job of an event.
    """
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
