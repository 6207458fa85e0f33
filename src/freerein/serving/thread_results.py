"""Results that a thread computes for futures of an event loop."""

import asyncio
import contextlib
import os
import weakref
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")

_READ_BYTES = 4096


class ThreadResults(Generic[T]):
    """Completes futures of one event loop from other threads.

    uvloop's `call_soon_threadsafe` wakes the loop while it holds the interpreter's lock. The system then often runs
    the woken thread first, which waits for that lock. A pipe is written without the lock.

    Args:
        loop: The running event loop. It must be used for all futures, and may close at any time.

    Attributes:
        loop: The event loop.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self._results: deque[tuple[asyncio.Future[T], T | Exception]] = deque()
        self._readable, self._writable = os.pipe()
        for end in (self._readable, self._writable):
            os.set_blocking(end, False)
            weakref.finalize(self, os.close, end)  # after the loop is closed, which holds `_deliver`
        loop.add_reader(self._readable, self._deliver)

    def put(self, future: "asyncio.Future[T]", result: T | Exception) -> None:
        """Adds the result of a future, or its exception; `send` delivers it."""
        self._results.append((future, result))

    def send(self) -> None:
        """Wakes the loop, which completes the futures that are not done by then."""
        with contextlib.suppress(BlockingIOError):  # the pipe is full: the loop will wake anyway
            os.write(self._writable, b"\0")

    def _deliver(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.read(self._readable, _READ_BYTES)
        while self._results:
            future, result = self._results.popleft()
            if future.done():
                continue
            if isinstance(result, Exception):
                future.set_exception(result)
            else:
                future.set_result(result)
