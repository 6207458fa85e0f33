"""The limits of a service; docs/protocol.md lists them all."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from freerein.errors import Overloaded

MAX_VALUES = 200_000
"""Values in one JSON body, or fields and packed numbers in one gRPC message."""
COPIES = 3
"""Copies of a body or message in memory: as received, as parsed, and decoded from base64 or multipart."""
MAX_INLINE_BYTES = 64 * 1024
"""Longer bodies and messages are parsed off the event loop, unless they are images: of few values, and not too long."""
MAX_INLINE_IMAGE_BYTES = 2**20
FEW_VALUES = 256


@dataclass(frozen=True)
class Limits:
    """Size, time and concurrency limits.

    Attributes:
        message_bytes: Bytes of one REST body or gRPC message.
        buffered_bytes: Bytes of memory for requests and replies together, with what is made of them: REST bodies, first
            messages of gRPC calls, messages of WebSockets, and replies until they are sent.
        receipt_s: Seconds to receive a whole HTTP request, the first message of a gRPC call, or a message of a
            WebSocket.
        slow_receipt_s: Seconds after which a gRPC message arrives slowly.
        write_s: Seconds that a client may leave a reply unread.
        unary_s: Seconds from request to reply of a unary call; a caller's shorter deadline takes precedence.
        queue: Items waiting for the model.
        batch: Items in one model call.
        streams: Streams open at once, over REST and over gRPC each; as many WebSockets.
        websocket_bytes: Bytes of one message of a WebSocket.
        idle_s: Seconds that a WebSocket may be open without a message.
        http_keep_alive_s: Seconds that an HTTP connection may be open without a request after the first.
        idle_connections: HTTP connections open at once without a request after the first.
        keep_alive_s: Seconds without an event after which a stream of them has a comment.
        ping_s: Seconds between two pings of a WebSocket, and from a ping until anything arrives.
        videos: Videos being decoded at once.
        concurrent_calls: gRPC calls in progress at once, without health checks.
        connection_calls: gRPC calls in progress at once on one connection.
        health_calls: gRPC health checks in progress at once.
        drain_delay_s: Seconds after SIGTERM in which a service that is no longer ready answers as before.
        drain_s: Seconds from then until calls in flight are cut.
    """

    message_bytes: int = 64 * 2**20
    buffered_bytes: int = 512 * 2**20
    receipt_s: float = 10.0
    slow_receipt_s: float = 1.0
    write_s: float = 30.0
    unary_s: float = 30.0
    queue: int = 256
    batch: int = 32
    streams: int = 64
    websocket_bytes: int = 8 * 2**20
    idle_s: float = 600.0
    http_keep_alive_s: float = 75.0
    idle_connections: int = 512
    keep_alive_s: float = 3.0
    ping_s: float = 10.0
    videos: int = 2
    concurrent_calls: int = 512
    connection_calls: int = 256
    health_calls: int = 64
    drain_delay_s: float = 0.0
    drain_s: float = 8.0

    @property
    def slow_messages(self) -> int:
        """How many gRPC messages may arrive slowly at once: each can take its greatest size, all half of the memory."""
        return self.buffered_bytes // (2 * self.message_bytes)


class Slots:
    """Bounds how many of something one server has at once; `what` completes "At most 64 ..." in the error.

    Attributes:
        taken: How many it has now.
    """

    def __init__(self, limit: int, what: str) -> None:
        self._limit = limit
        self._what = what
        self.taken = 0

    def take(self, count: int = 1) -> None:
        """Takes slots. Raises Overloaded when too few are free."""
        if self.taken + count > self._limit:
            raise Overloaded(
                f"At most {self._limit} {self._what} at once; the limit is reached.",
                hint="Try again after Retry-After, or call another replica.",
            )
        self.taken += count

    def free(self, count: int = 1) -> None:
        """Gives slots back."""
        self.taken -= count

    @contextmanager
    def hold(self, count: int = 1) -> Iterator[None]:
        """Holds slots for the length of the block. Raises Overloaded when too few are free."""
        self.take(count)
        try:
            yield
        finally:
            self.free(count)
