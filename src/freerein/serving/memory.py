"""One budget of bytes for what callers send and are sent, over REST, gRPC and WebSockets.

What counts are bytes on the wire, times `COPIES`: as received, as parsed or encoded, and decoded from base64.
"""

import asyncio
import ctypes
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import is_dataclass
from typing import Any, TypeVar

import numpy as np

from freerein.serving.limits import COPIES, MAX_INLINE_BYTES, Limits, Slots

T = TypeVar("T")

_TRIM_BYTES = 128 * 2**20
_VERY_LARGE_BYTES = 8 * 2**20
_malloc_trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # other C libraries have none


class Memory:
    """The bytes that all calls and connections of one service may hold together, `Limits.buffered_bytes`.

    Attributes:
        encoding: Held while a very large reply is encoded: the interpreter does so one at a time anyway, and the event
            loop waits for all that want to.
    """

    def __init__(self, limits: Limits) -> None:
        self.encoding = asyncio.Lock()
        self._bytes = Slots(limits.buffered_bytes, "bytes of requests and replies may be in memory")
        self._peak = 0

    @property
    def taken(self) -> int:
        """Bytes that are held now."""
        return self._bytes.taken

    @contextmanager
    def share(self) -> Iterator["Share"]:
        """Has the share of one call or connection while the block runs."""
        share = Share(self)
        try:
            yield share
        finally:
            share.close()

    def share_of_task(self) -> "Share":
        """Returns a share that the end of the current task closes."""
        share, task = Share(self), asyncio.current_task()
        if task is not None:
            task.add_done_callback(lambda _: share.close())
        return share

    def take(self, count: int) -> None:
        """Takes bytes. Raises Overloaded when too few are left."""
        self._bytes.take(count)
        self._peak = max(self._peak, self.taken)

    def free(self, count: int) -> None:
        """Gives bytes back; to the system, too, where they were many: the allocator would keep what lies between."""
        self._bytes.free(count)
        if self._peak >= _TRIM_BYTES and self.taken < self._peak // 4:
            self._peak = self.taken
            if _malloc_trim is not None:
                asyncio.get_running_loop().run_in_executor(None, _malloc_trim, 0)


class Share:
    """The bytes of a `Memory` that one call or connection holds; `encoding` is that of the memory."""

    def __init__(self, memory: Memory) -> None:
        self.encoding = memory.encoding
        self._memory = memory
        self._bytes = 0

    def take(self, count: int) -> None:
        """Takes more bytes. Raises Overloaded when too few are left."""
        self._memory.take(count)
        self._bytes += count

    def resize(self, count: int) -> None:
        """Holds so many bytes instead. Raises Overloaded when too few are left."""
        if count > self._bytes:
            self.take(count - self._bytes)
        elif count < self._bytes:
            freed, self._bytes = self._bytes - count, count
            self._memory.free(freed)

    def close(self) -> None:
        """Gives all bytes back."""
        self.resize(0)


async def encode(response: Any, write: Callable[[Any], T], share: Share) -> T:
    """Returns a reply as `write` writes it; off the event loop where it is large, and counted.

    Raises:
        Overloaded: Too few bytes are left for it.
    """
    size = _size_of(response)
    share.take(COPIES * size)
    if size <= MAX_INLINE_BYTES:
        return write(response)
    async with share.encoding if size >= _VERY_LARGE_BYTES else nullcontext():
        return await asyncio.to_thread(write, response)


def _size_of(value: object) -> int:
    """Returns the bytes of the arrays, files and texts of a dataclass."""
    if value is None or isinstance(value, int | float):  # most are
        return 0
    if isinstance(value, np.ndarray):
        return value.nbytes
    if isinstance(value, bytes | str):
        return len(value)
    parts: Iterable[object] = ()
    if isinstance(value, tuple | list):
        parts = value
    elif isinstance(value, dict):
        parts = value.values()
    elif is_dataclass(value):
        parts = vars(value).values()
    return sum(map(_size_of, parts))
