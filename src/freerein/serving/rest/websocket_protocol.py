"""uvicorn's WebSocket protocol with bounds of what a client may send or leave unread."""

import asyncio
from typing import Any, ClassVar

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame

from freerein.serving.limits import Limits

_MAX_FRAMES = 1024
_CLOSE_S = 1.0


class BoundedWebSocketProtocol(WebSocketsSansIOProtocol):
    """Refuses messages in tiny fragments, drops what clients do not read, and leaves the drain to the endpoint."""

    limits: ClassVar[Limits]
    _abort_timer: asyncio.TimerHandle | None = None

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.close_timeout = _CLOSE_S

    def data_received(self, data: bytes) -> None:
        """Closes the connection when its first bytes, which are a whole request, are no handshake."""
        super().data_received(data)
        if not self.handshake_initiated:
            self.transport.close()

    def handle_cont(self, event: Frame) -> None:
        """Takes a fragment of a message. Closes the connection when there are too many: each takes memory."""
        if len(self.frames) >= _MAX_FRAMES:
            self.conn.fail(1009, f"a message may have {_MAX_FRAMES} fragments")
            self.handle_parser_exception()
        else:
            super().handle_cont(event)

    def handle_ping(self) -> None:
        """Answers a ping, unless earlier answers were not read."""
        answers = self.conn.data_to_send()
        if self.writable.is_set():
            self.transport.write(b"".join(answers))

    def handle_parser_exception(self) -> None:
        """Says why the connection ends, and reads on for a moment: a client that still sends would not learn it."""
        closing = self.conn.close_sent
        if self.close_sent or closing is None:
            return
        self.queue.put_nowait({"type": "websocket.disconnect", "code": closing.code, "reason": closing.reason})
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        self.close_timer = self.loop.call_later(self.close_timeout, self.transport.close)

    def keepalive_timeout(self) -> None:
        """Ends a connection whose client answers no pings, and so will not read that it ends."""
        super().keepalive_timeout()
        self.transport.abort()

    def shutdown(self) -> None:
        """Does nothing, when the server stops: the endpoint sends what the model still answers, then closes."""

    async def send(self, message: Any) -> None:
        """Sends a message. A refusal in place of the handshake completes it, too, which uvicorn would call an error."""
        await super().send(message)
        if message["type"] == "websocket.http.response.body":
            self.handshake_complete = True

    async def run_asgi(self) -> None:
        """Runs the endpoint. What it sent last must be read in time."""
        await super().run_asgi()
        if not self.disconnected:
            self._abort_timer = self.loop.call_later(self.limits.write_s, self.transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stops the deadline."""
        super().connection_lost(exc)
        if self._abort_timer is not None:
            self._abort_timer.cancel()
