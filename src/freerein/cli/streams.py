"""Streams that survive a restart of their service."""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from typing import TypeVar

from freerein.errors import Unavailable, WorkerLost

T = TypeVar("T")

TIMEOUT_S = 30.0
_RETRY_S = 0.5


async def reconnecting(
    open_stream: Callable[[], AsyncGenerator[T, None]], *, timeout_s: float = TIMEOUT_S
) -> AsyncGenerator[T, None]:
    """Yields the items of a stream; opens it again when the service goes away.

    Args:
        open_stream: Opens the stream where it broke off.
        timeout_s: How long the service may be away. A stream that was open for longer, however quiet, shows that it
            was there.

    Raises:
        Unavailable: The service stayed away, or `WorkerLost`.
    """
    there_s = time.monotonic()
    while True:
        opened_s = time.monotonic()
        try:
            async with aclosing(open_stream()) as items:
                async for item in items:
                    there_s = time.monotonic()
                    yield item
            return
        except (Unavailable, WorkerLost):
            broken_s = time.monotonic()
            if broken_s - opened_s > timeout_s:
                there_s = broken_s
            if broken_s - there_s > timeout_s:
                raise
            await asyncio.sleep(_RETRY_S)
