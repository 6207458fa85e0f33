"""The bounds of a service. docs/protocol.md shows them as a table."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from freerein.errors import Overloaded


@dataclass(frozen=True)
class Limits:
    """Everything that is bounded, and by how much.

    Attributes:
        message_bytes: One REST body or gRPC message.
        buffered_bytes: All REST bodies being received or worked on together.
        receipt_s: From a connection's first byte wanted to a request's last byte received.
        write_s: How long a reader may leave a reply unread.
        unary_s: From request to reply of a unary call; a caller's shorter deadline holds.
        queue: Items waiting for the model.
        batch: Items in one model call.
        streams: Streams open at once.
        concurrent_calls: gRPC calls open at once.
        drain_s: From SIGTERM to the end of what was in flight.
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
    """Bounds how many streams one server has open.

    Args:
        limit: Streams open at once.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._open = 0

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Holds one slot for the length of the block.

        Raises:
            Overloaded: All slots are held.
        """
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
