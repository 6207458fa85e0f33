"""Whether a service is live, ready or draining, and the event that tells every stream to end."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import TypeVar

from freerein.errors import Unavailable

T = TypeVar("T")


class Health:
    """Readiness of one service: open doors, warm models, not draining.

    Args:
        not_ready: Returns why the core is not ready, empty when it is.
    """

    def __init__(self, not_ready: Callable[[], str] = lambda: "") -> None:
        self._not_ready = not_ready
        self._draining = asyncio.Event()

    def reason(self) -> str:
        """Returns why the service is not ready, empty when it is."""
        return "It is draining." if self._draining.is_set() else self._not_ready()

    def error(self) -> Unavailable:
        """Returns what a call is answered while the service is not ready."""
        return Unavailable(
            f"The service must be ready; it is not: {self.reason()}", hint="Try again, or call another replica."
        )

    @property
    def draining(self) -> bool:
        """Whether the service has been told to stop."""
        return self._draining.is_set()

    def drain(self) -> None:
        """Makes the service not ready for good and wakes everything that waits for it."""
        self._draining.set()

    async def wait_for_drain(self) -> None:
        """Returns when the service has been told to stop."""
        await self._draining.wait()

    async def await_or_drain(self, step: Awaitable[T]) -> T | None:
        """Returns what `step` returns, or None, with `step` cancelled, when draining begins first."""
        work = asyncio.ensure_future(step)
        drain = asyncio.ensure_future(self._draining.wait())
        try:
            await asyncio.wait({work, drain}, return_when=asyncio.FIRST_COMPLETED)
            return work.result() if work.done() else None
        finally:
            work.cancel()
            drain.cancel()

    async def iterate_until_drain(self, items: AsyncIterator[T]) -> AsyncIterator[T]:
        """Yields what `items` yields, and ends when it ends or draining begins."""
        drain = asyncio.ensure_future(self._draining.wait())
        following: asyncio.Future[T] | None = None
        try:
            while not self.draining:
                following = asyncio.ensure_future(anext(items))
                await asyncio.wait({following, drain}, return_when=asyncio.FIRST_COMPLETED)
                if not following.done():
                    return
                try:
                    item = following.result()
                except StopAsyncIteration:
                    return
                yield item
        finally:
            drain.cancel()
            if following is not None:
                following.cancel()
