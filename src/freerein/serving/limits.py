"""The limits of a service; docs/protocol.md lists them all."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from freerein.errors import Overloaded


@dataclass(frozen=True)
class Limits:
    """Size, time and concurrency limits.

    Attributes:
        message_bytes: Bytes of one REST body or gRPC message.
        buffered_bytes: Bytes of memory for all REST bodies together, and for what is parsed of them.
        receipt_s: Seconds to receive a whole HTTP request.
        write_s: Seconds that a client may leave a reply unread.
        unary_s: Seconds from request to reply of a unary call; a caller's shorter deadline takes precedence.
        queue: Items waiting for the model.
        batch: Items in one model call.
        streams: Streams open at once, over REST and over gRPC each.
        concurrent_calls: gRPC calls in progress at once.
        drain_s: Seconds from SIGTERM until calls in flight are cut.
    """

    message_bytes: int = 64 * 2**20
    buffered_bytes: int = 512 * 2**20
    receipt_s: float = 10.0
    write_s: float = 30.0
    unary_s: float = 30.0
    queue: int = 256
    batch: int = 32
    streams: int = 64
    concurrent_calls: int = 512
    drain_s: float = 8.0


class StreamSlots:
    """Bounds how many streams one server has open at once."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._open = 0

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Holds one slot for the length of the block. Raises Overloaded when all slots are held."""
        if self._open >= self._limit:
            raise Overloaded(
                f"At most {self._limit} streams may be open at once; the limit is reached.",
                hint="Close a stream first, or call another replica.",
            )
        self._open += 1
        try:
            yield
        finally:
            self._open -= 1
