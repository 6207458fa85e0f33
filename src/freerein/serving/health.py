"""Liveness, readiness and graceful shutdown of a service."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import TypeVar

from freerein.errors import Unavailable

T = TypeVar("T")


class Health:
    """Readiness of one service, and the event that begins its graceful shutdown.

    `not_ready` returns why the service is not ready, empty when it is.
    """

    def __init__(self, not_ready: Callable[[], str] = lambda: "") -> None:
        self._not_ready = not_ready
        self._draining = asyncio.Event()
        self._leaving = False

    def reason(self) -> str:
        """Returns why the service is not ready, empty when it is."""
        if self._draining.is_set():
            return "It is draining."
        return "It is about to drain." if self._leaving else self._not_ready()

    def error(self) -> Unavailable:
        """Returns the error of a call to a service that is not ready."""
        return Unavailable(
            f"The service must be ready; it is not: {self.reason()}", hint="Try again, or call another replica."
        )

    @property
    def draining(self) -> bool:
        """Whether the graceful shutdown has begun."""
        return self._draining.is_set()

    def leave(self) -> None:
        """Makes the service not ready from now on, so that load balancers choose others; it answers as before."""
        self._leaving = True

    def drain(self) -> None:
        """Begins the graceful shutdown: the service is not ready from now on, and waiting streams end."""
        self._draining.set()

    async def wait_for_drain(self) -> None:
        """Waits until the graceful shutdown begins."""
        await self._draining.wait()

    async def await_or_drain(self, step: Awaitable[T]) -> T | None:
        """Returns the result of `step`; cancels it and returns None when the graceful shutdown begins first."""
        work = asyncio.ensure_future(step)
        drain = asyncio.ensure_future(self._draining.wait())
        try:
            await asyncio.wait({work, drain}, return_when=asyncio.FIRST_COMPLETED)
            return work.result() if work.done() else None
        finally:
            work.cancel()
            drain.cancel()

    async def iterate_until_drain(self, items: AsyncIterator[T]) -> AsyncIterator[T]:
        """Yields from `items` until they end or the graceful shutdown begins."""
        while not self.draining and (item := await self.await_or_drain(anext(items, None))) is not None:
            yield item
