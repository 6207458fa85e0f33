"""Streams that outlive a restart of their service."""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from typing import TypeVar

from freerein.errors import Unavailable, WorkerLost

T = TypeVar("T")

PATIENCE_S = 30.0
_RETRY_S = 0.5


async def unbroken(
    open_stream: Callable[[], AsyncGenerator[T, None]], *, patience_s: float = PATIENCE_S
) -> AsyncGenerator[T, None]:
    """Yields what a stream yields; opens it again when the service goes away in the middle.

    Args:
        open_stream: Opens it where the last one broke off.
        patience_s: How long nothing may come while the service is away, in seconds.

    Raises:
        Unavailable: The service stayed away, or `WorkerLost`.
    """
    heard = time.monotonic()
    while True:
        try:
            async with aclosing(open_stream()) as items:
                async for item in items:
                    heard = time.monotonic()
                    yield item
            return
        except (Unavailable, WorkerLost):
            if time.monotonic() - heard > patience_s:
                raise
            await asyncio.sleep(_RETRY_S)
