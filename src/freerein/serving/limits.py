"""The bounds of a service. docs/protocol.md shows them as a table."""

from dataclasses import dataclass


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
