"""Follows a fit or a run to its end, through restarts of its service."""

from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from typing import Protocol, TypeVar

from freerein.cli.streams import unbroken
from freerein.cli.underway import Underway
from freerein.clients import FitClient, OrchestratorClient
from freerein.errors import Unavailable
from freerein.types.learning import Fit, WatchFitRequest
from freerein.types.orchestrator import Run, WatchRunRequest


class _Event(Protocol):
    @property
    def sequence(self) -> int: ...


E = TypeVar("E", bound=_Event)
U = TypeVar("U", bound=Underway)


def follow_fit(client: FitClient, fit_id: str) -> AsyncGenerator[Fit, None]:
    """Yields a fit as it stood after each change, from its first to its last.

    Raises:
        ServiceError: There is no such fit, or the service went away for good.
    """
    return _follow(lambda start: client.watch_fit(WatchFitRequest(fit_id, start)), lambda event: event.fit)


def follow_run(client: OrchestratorClient, run_id: str) -> AsyncGenerator[Run, None]:
    """Yields a run as it stood after each change, from its first to its last.

    One that was resumed has ended before, and goes on.

    Raises:
        ServiceError: There is no such run, or the orchestrator went away for good.
    """
    return _follow(lambda start: client.watch_run(WatchRunRequest(run_id, start)), lambda event: event.run)


async def _follow(
    watch: Callable[[int], AsyncGenerator[E, None]], subject: Callable[[E], U]
) -> AsyncGenerator[U, None]:
    """Yields what events are about.

    Args:
        watch: Opens the events from a sequence number on.
        subject: Returns what an event is about.
    """
    seen, has_ended = -1, False

    async def rest() -> AsyncGenerator[E, None]:
        async with aclosing(watch(seen + 1)) as events:
            async for event in events:
                yield event
        if not has_ended:
            raise Unavailable("Events must go on to the end; they broke off.", hint="Watch it again.")

    async with aclosing(unbroken(rest)) as events:
        async for event in events:
            now = subject(event)
            seen, has_ended = event.sequence, now.ended
            yield now
