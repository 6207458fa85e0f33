"""uvicorn's WebSocket protocol with bounds of what a client may send, how fast, and what it may leave unread."""

import asyncio
from collections import deque
from typing import Any, ClassVar

from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame

from freerein.errors import DeadlineExceeded, MalformedRequest, Overloaded, ServiceError, TooLarge
from freerein.serving.error_replies import close_reason
from freerein.serving.limits import COPIES, Limits
from freerein.serving.memory import Memory, Share
from freerein.serving.rest.websocket import ERROR

_MAX_FRAMES = 1024
_CLOSE_S = 1.0
_PIECE_BYTES = 16 * 1024  # the smallest frames in it take 30 ms to parse
_FRAMES_PER_S = 128
_MOST_FRAMES = 2 * _MAX_FRAMES  # at once
_POLICY_VIOLATION, _TRY_AGAIN_LATER, _INVALID_DATA, _TOO_BIG = 1008, 1013, 1007, 1009


class BoundedWebSocketProtocol(WebSocketsSansIOProtocol):
    """Bounds frames, messages and their bytes, drops what clients do not read, and leaves the drain to the endpoint.

    What arrives counts in the memory of the service until the endpoint asks for the next message, and so has answered.
    """

    limits: ClassVar[Limits]
    memory: ClassVar[Memory]
    _error: ServiceError | None = None
    _abort_timer: asyncio.TimerHandle | None = None
    _receipt_timer: asyncio.TimerHandle | None = None

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.close_timeout = _CLOSE_S
        self._share = Share(self.memory)
        self._queued: deque[int] = deque()  # bytes of each message in the queue
        self._answered_bytes = 0  # of the one that the endpoint answers
        self._frames, self._frames_at_s = 0.0, self.loop.time()

    def data_received(self, data: bytes) -> None:
        """Takes what arrives, in pieces, and checks all bounds after each.

        Closes the connection when its first bytes, which are a whole request, are no handshake.
        """
        if not self.handshake_initiated:
            super().data_received(data)
            if not self.handshake_initiated:
                self.transport.close()
            return
        for at in range(0, len(data), _PIECE_BYTES):
            super().data_received(data[at : at + _PIECE_BYTES])
            if self.close_sent or self.transport.is_closing():
                return
            self._check_bounds()
        self._put_off_ping()
        self._time_receipt()

    def handle_events(self) -> None:
        """Handles frames, and counts them."""
        self._frames += len(self.conn.events)
        super().handle_events()

    def handle_cont(self, event: Frame) -> None:
        """Takes a fragment of a message. Closes the connection when there are too many: each takes memory."""
        if len(self.frames) >= _MAX_FRAMES:
            error = TooLarge(f"A message may have {_MAX_FRAMES} fragments; it has more.", hint="Send it whole.")
            self._fail(_TOO_BIG, error)
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
        self._error = self._error or _violation(closing.code)
        event: Any = {"type": "websocket.disconnect", "code": closing.code, ERROR: self._error}
        self.queue.put_nowait(event)
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        self.close_timer = self.loop.call_later(self.close_timeout, self.transport.close)

    def send_receive_event_to_app(self) -> None:
        """Queues a whole message. Closes the connection when it is a text in no UTF-8."""
        if self.curr_msg_data_type == "text" and not _is_utf8(self.frames):
            self._fail(
                _INVALID_DATA, MalformedRequest("A text must be UTF-8; it is not.", hint="Send binary messages.")
            )
            return
        if not self.close_sent:
            self._queued.append(sum(map(len, self.frames)))
        super().send_receive_event_to_app()

    def keepalive_timeout(self) -> None:
        """Ends a connection whose client answers no pings, and so will not read that it ends."""
        super().keepalive_timeout()
        self.transport.abort()

    def shutdown(self) -> None:
        """Does nothing, when the server stops: the endpoint sends what the model still answers, then closes."""

    async def receive(self) -> Any:
        """Returns the next message; the one before has been answered."""
        self._answered_bytes = 0
        if not self.close_sent:
            self._count_bytes()
        message = await super().receive()
        if message["type"] == "websocket.receive":
            self._answered_bytes = self._queued.popleft()
            self._frames -= 1  # messages are as many as their answers
        self._time_receipt()
        return message

    async def send(self, message: Any) -> None:
        """Sends a message. A refusal in place of the handshake completes it, too, which uvicorn would call an error."""
        if self.close_sent and self.initial_response is None:  # uvicorn would call it an error of the endpoint
            raise self._error or ClientDisconnected
        await super().send(message)
        if message["type"] == "websocket.http.response.body":
            self.handshake_complete = True

    async def run_asgi(self) -> None:
        """Runs the endpoint. What it sent last must be read in time."""
        try:
            await super().run_asgi()
        finally:
            self._share.close()
        if not self.disconnected:
            self._abort_timer = self.loop.call_later(self.limits.write_s, self.transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stops the deadlines."""
        super().connection_lost(exc)
        for timer in (self._abort_timer, self._receipt_timer):
            if timer is not None:
                timer.cancel()

    def _check_bounds(self) -> None:
        """Closes the connection when its frames are too many, or their bytes more than all connections may have."""
        now_s = self.loop.time()
        self._frames = max(0.0, self._frames - _FRAMES_PER_S * (now_s - self._frames_at_s))
        self._frames_at_s = now_s
        if self._frames > _MOST_FRAMES:
            detail = f"Frames besides answered messages may be {_FRAMES_PER_S} a second; there are more."
            self._fail(_POLICY_VIOLATION, Overloaded(detail, hint="Send messages whole, one by one."))
            return
        try:
            self._count_bytes()
        except Overloaded as error:
            self._fail(_TRY_AGAIN_LATER, error)

    def _count_bytes(self) -> None:
        partial = len(self.conn.reader.buffer) + (self.conn.current_size or 0)
        self._share.resize(COPIES * (partial + sum(self._queued) + self._answered_bytes))

    def _time_receipt(self) -> None:
        """Starts the deadline of a message that has begun, unless it runs; stops it when none is awaited."""
        is_begun = self.conn.reader.buffer or self.conn.current_size is not None
        is_awaited = is_begun and not self.read_paused and not self.close_sent
        if is_awaited and self._receipt_timer is None:
            self._receipt_timer = self.loop.call_later(self.limits.receipt_s, self._end_receipt)
        elif not is_awaited and self._receipt_timer is not None:
            self._receipt_timer.cancel()
            self._receipt_timer = None

    def _end_receipt(self) -> None:
        within_s = self.limits.receipt_s
        error = DeadlineExceeded(
            f"A message must arrive within {within_s:g} s; this one did not.",
            hint="Send less, or raise FREEREIN_RECEIPT_S.",
        )
        self._fail(_POLICY_VIOLATION, error)

    def _put_off_ping(self) -> None:
        """Takes whatever arrives for the answer to a ping: some tunnels drop pongs."""
        if self.pong_timer is not None:
            self.pong_timer.cancel()
            self.pong_timer = self.pending_ping_payload = None
            self.schedule_ping()

    def _fail(self, code: int, error: ServiceError) -> None:
        """Closes the connection with an error, and forgets what arrived."""
        self._error = error
        self.conn.fail(code, close_reason(error))
        self.frames = []
        if self.conn.close_sent is None:  # the endpoint has not accepted it yet
            self.transport.close()
        self.handle_parser_exception()


def _violation(code: int) -> ServiceError:
    """Returns the error of a connection that breaks the WebSocket protocol, or its limit of a message's bytes."""
    if code == _TOO_BIG:
        return TooLarge("A message is over the limit of a WebSocket.", hint="Send less per message.")
    return MalformedRequest("The client must keep to the WebSocket protocol; it does not.", hint="Use a library.")


def _is_utf8(frames: list[bytes]) -> bool:
    try:
        b"".join(frames).decode()
    except UnicodeDecodeError:
        return False
    return True
