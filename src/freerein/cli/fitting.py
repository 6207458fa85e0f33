"""Follows a fit to its end, through restarts of its service."""

from collections.abc import AsyncGenerator
from contextlib import aclosing

from freerein.cli.streams import unbroken
from freerein.clients import FitClient
from freerein.errors import Unavailable
from freerein.types.learning import Fit, WatchFitRequest, WatchFitResponse


async def follow(client: FitClient, fit_id: str) -> AsyncGenerator[Fit, None]:
    """Yields a fit as it stands after each change, from its first to its last.

    Raises:
        ServiceError: There is no such fit, or the service went away for good.
    """
    seen = -1

    async def rest() -> AsyncGenerator[WatchFitResponse, None]:
        async with aclosing(client.watch_fit(WatchFitRequest(fit_id, from_sequence=seen + 1))) as events:
            async for event in events:
                yield event
                if event.fit.ended:
                    return
        raise Unavailable("The events of a fit must go on to its end; they broke off.", hint="Watch it again.")

    async with aclosing(unbroken(rest)) as events:
        async for event in events:
            seen = event.sequence
            yield event.fit
