"""Calls that end with their clients: what one that has left waited for is cancelled, and what it held is released."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from typing import Any

from starlette.requests import Request
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from freerein.errors import Cancelled, DeadlineExceeded


@asynccontextmanager
async def while_connected(
    request: Request, timeout_s: float | None = None, *, body_read: asyncio.Event | None = None
) -> AsyncIterator[None]:
    """Cancels the block when the client disconnects or the time is up, which are then errors.

    A block that reads the request's body itself says by `body_read` that it has.
    """
    gone = asyncio.ensure_future(_disconnected(request, body_read))

    def end_now(_: object) -> None:
        with suppress(RuntimeError):  # it has ended meanwhile
            deadline.reschedule(0)

    try:
        async with asyncio.timeout(timeout_s) as deadline:
            gone.add_done_callback(end_now)
            yield
    except TimeoutError:
        if not deadline.expired():
            raise
        if gone.done():
            gone.result()  # raises when the request's body is over a limit
            raise Cancelled("The client disconnected before the reply.") from None
        raise DeadlineExceeded(
            f"The reply was due within {timeout_s:g} s; it was not ready.", hint="Send less per call."
        ) from None
    finally:
        gone.cancel()
        await asyncio.gather(gone, return_exceptions=True)


async def _disconnected(request: Request, body_read: asyncio.Event | None) -> None:
    if body_read is not None:
        await body_read.wait()
    while (await request.receive())["type"] != "http.disconnect":
        pass


class HeldResponse(StreamingResponse):
    """A streaming response that releases its resources when it ends, whether or not its body was iterated."""

    def __init__(self, content: AsyncIterator[bytes], resources: AsyncExitStack, **options: Any) -> None:
        super().__init__(content, **options)
        self._resources = resources

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Sends it."""
        async with self._resources:
            await super().__call__(scope, receive, send)
