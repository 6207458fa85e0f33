"""uvicorn with deadlines for handshakes, requests and replies, no tiny chunks, and exit code 0 on SIGTERM."""

import asyncio
import math
import socket
import time
import uuid
from typing import Any, ClassVar, cast

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from freerein.errors import MalformedRequest, ServiceError
from freerein.serving.error_replies import problem_response
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.memory import Memory
from freerein.serving.rest.middleware import LATE, MAX_HEADER_BYTES, REQUEST_ID, late_request

_MIN_MEAN_CHUNK_BYTES = 64
_MIN_BYTES_IN_CHUNKS = 16 * 1024  # fewer may come in chunks of any size
_LINGER_S = 0.5


class BoundedConnection(h11.Connection):
    """HTTP/1.1 parser that refuses bodies of tiny chunks, since the time to parse grows with their number.

    It counts HTTP chunks. TCP segments are not counted: they are merged while the parser is busy.
    """

    _chunks = _body_bytes = 0

    def next_event(self) -> Any:
        """Returns the next event; raises h11.RemoteProtocolError when the mean chunk is too small."""
        event = super().next_event()
        if isinstance(event, h11.Request):
            self._chunks = self._body_bytes = 0
        elif isinstance(event, h11.Data):
            self._body_bytes += len(event.data)
            if _MIN_BYTES_IN_CHUNKS < self._body_bytes < _MIN_MEAN_CHUNK_BYTES * self._chunks:
                raise h11.RemoteProtocolError("the chunks are too small")
            self._chunks += event.chunk_end  # not those that TCP cuts, and not the last, which may be small
        return event


class DeadlineProtocol(H11Protocol):
    """Ends a connection whose client sends its request, or reads its reply, too slowly, or sends nothing.

    Attributes:
        idle: The connections that wait for another request, those that wait longest first.
    """

    limits: ClassVar[Limits]
    idle: ClassVar[dict["DeadlineProtocol", None]]
    _receive_timer: asyncio.TimerHandle | None = None
    _write_timer: asyncio.TimerHandle | None = None
    _is_late = False

    def __init__(self, config: uvicorn.Config, *args: Any, **kwargs: Any) -> None:
        super().__init__(config, *args, **kwargs)
        self.conn = BoundedConnection(h11.SERVER, MAX_HEADER_BYTES)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's
        """Starts the receive deadline."""
        super().connection_made(transport)
        self._start_receive_timer()

    def data_received(self, data: bytes) -> None:
        """Starts the receive deadline, unless it runs already."""
        self.idle.pop(self, None)
        if self._is_late:
            return
        self._start_receive_timer()
        super().data_received(data)

    def handle_events(self) -> None:
        """Stops the receive deadline when the whole request has arrived; another may have begun with it."""
        super().handle_events()
        if self.transport.get_protocol() is not self:  # a WebSocket has the connection
            return
        if self.conn.their_state is h11.SEND_BODY or (self.conn.their_state is h11.IDLE and self.conn.trailing_data[0]):
            self._start_receive_timer()
        elif self.conn.their_state is not h11.IDLE:
            self._stop_receive_timer()

    def pause_writing(self) -> None:
        """Starts the write deadline anew: what was left of an earlier reply has been read, or is waited for still."""
        super().pause_writing()
        self._stop_write_timer()
        self._start_write_timer()

    def resume_writing(self) -> None:
        """Stops the write deadline."""
        super().resume_writing()
        self._stop_write_timer()

    def on_response_complete(self) -> None:
        """Starts the write deadline for what is still in the transport's buffer. Closes the longest idle connection."""
        super().on_response_complete()
        if self.transport.get_write_buffer_size():
            self._start_write_timer()
        if self.timeout_keep_alive_task is not None:  # another request may come
            self.idle[self] = None
        if len(self.idle) > self.limits.idle_connections:
            oldest = next(iter(self.idle))
            del self.idle[oldest]
            oldest.timeout_keep_alive_handler()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Stops both deadlines: from here on another protocol has the connection."""
        self._stop_receive_timer()
        self._stop_write_timer()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stops both deadlines."""
        self.idle.pop(self, None)
        self._stop_receive_timer()
        super().connection_lost(exc)
        self._stop_write_timer()

    def send_400_response(self, msg: str) -> None:
        """Answers bytes that are not HTTP with a problem document, and closes the connection."""
        if self.cycle is None or self.cycle.response_complete or not self.cycle.response_started:
            self.transport.write(_bad_request())
        self.transport.close()

    def _start_receive_timer(self) -> None:
        if self._receive_timer is None:
            self._receive_timer = self.loop.call_later(self.limits.receipt_s, self._end_receipt)

    def _end_receipt(self) -> None:
        """Answers a request that is late, unless its reply has begun, and closes the connection.

        What still arrives is dropped for a moment: a client that is reset while it sends would not read the answer.
        """
        in_progress = self.cycle is not None and not self.cycle.response_complete
        has_begun = in_progress or self.conn.trailing_data[0]
        if not has_begun or (in_progress and self.cycle.response_started):
            self.transport.abort()
            return
        self._is_late = True
        request_id = self._end_cycle() if in_progress else uuid.uuid4().hex
        self.transport.write(_problem(late_request(self.limits.receipt_s), request_id))
        if self.transport.can_write_eof():  # not so with TLS
            self.transport.write_eof()
        self.flow.resume_reading()
        self.loop.call_later(_LINGER_S, self.transport.abort)

    def _end_cycle(self) -> str:
        """Lets the app end a request whose reply it cannot send any more; returns the request's id."""
        scope = cast(dict[str, Any], self.cycle.scope)
        scope[LATE] = self.limits.receipt_s
        self.cycle.disconnected = True
        self.cycle.message_event.set()
        return str(scope.get(REQUEST_ID, ""))

    def _start_write_timer(self) -> None:
        if self._write_timer is None:
            self._write_timer = self.loop.call_later(self.limits.write_s, self._abort_if_unread)

    def _stop_receive_timer(self) -> None:
        if self._receive_timer is not None:
            self._receive_timer.cancel()
            self._receive_timer = None

    def _stop_write_timer(self) -> None:
        if self._write_timer is not None:
            self._write_timer.cancel()
            self._write_timer = None

    def _abort_if_unread(self) -> None:
        self._write_timer = None
        if self.transport.get_write_buffer_size():
            self.transport.abort()


def _bad_request() -> bytes:
    error = MalformedRequest(
        "The bytes must be an HTTP/1.1 request with headers of at most 16 KiB, and chunks of 64 bytes or more on "
        "average; they are not.",
        hint="Use an HTTP client that sends large chunks, or Content-Length.",
    )
    return _problem(error, uuid.uuid4().hex)


def _problem(error: ServiceError, request_id: str) -> bytes:
    """Returns an error as a whole HTTP reply."""
    response = problem_response(error, request_id)
    lines = [b"HTTP/1.1 %d " % error.http_status, *(b"%s: %s" % each for each in response.raw_headers), b"", b""]
    return b"\r\n".join(lines) + response.body


class HttpServer(uvicorn.Server):
    """A uvicorn server that, on a stop signal, marks the service as draining and ends with exit code 0.

    For `Limits.drain_delay_s` before that, unless a second signal comes, the service is only not ready.
    """

    def __init__(self, config: uvicorn.Config, health: Health, limits: Limits) -> None:
        super().__init__(config)
        self._health = health
        self._limits = limits
        self._drain_at_s = math.inf

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listens on the sockets as uvicorn does, and with a deadline for TLS, for which uvicorn has no option."""
        await super().startup(sockets=[])
        config, loop = self.config, asyncio.get_running_loop()

        def make_protocol() -> asyncio.Protocol:
            return config.http_protocol_class(  # type: ignore[call-arg]  # as uvicorn's
                config=config, server_state=self.server_state, app_state=self.lifespan.state
            )

        tls_s = self._limits.receipt_s if config.ssl else None
        for each in sockets or []:
            server = await loop.create_server(
                make_protocol,
                sock=each,
                ssl=config.ssl,
                backlog=config.backlog,
                ssl_handshake_timeout=tls_s,
                ssl_shutdown_timeout=tls_s,
            )
            self.servers.append(server)

    def handle_exit(self, sig: int, frame: Any) -> None:
        """Begins the graceful shutdown. The signal is not recorded, so that uvicorn does not raise it again."""
        is_first = math.isinf(self._drain_at_s)
        self._drain_at_s = time.monotonic() + (self._limits.drain_delay_s if is_first else 0.0)
        self._health.leave()
        self._drain_if_due()

    async def on_tick(self, counter: int) -> bool:
        """Returns whether the server must stop; called ten times a second."""
        self._drain_if_due()
        return await super().on_tick(counter)

    def _drain_if_due(self) -> None:
        if time.monotonic() >= self._drain_at_s:
            self._health.drain()
            self.should_exit = True


def make_server(
    app: Any,
    *,
    limits: Limits,
    health: Health,
    cert: str | None,
    key: str | None,
    memory: Memory | None = None,
    has_websocket: bool = False,
) -> HttpServer:
    """Returns the HTTP server of the REST API; `serve(sockets=[...])` runs it."""
    config = uvicorn.Config(
        app,
        http=type("LimitedProtocol", (DeadlineProtocol,), {"limits": limits, "idle": {}}),
        ws=_websocket_protocol(limits, memory or Memory(limits)) if has_websocket else "none",
        ws_max_size=limits.websocket_bytes,
        ws_ping_interval=limits.ping_s,
        ws_ping_timeout=limits.ping_s,
        ws_per_message_deflate=False,
        lifespan="off",
        access_log=False,
        log_config=None,
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=limits.http_keep_alive_s,  # type: ignore[arg-type]  # any number does
        timeout_graceful_shutdown=int(limits.drain_s),
        ssl_certfile=cert,
        ssl_keyfile=key,
    )
    return HttpServer(config, health, limits)


def _websocket_protocol(limits: Limits, memory: Memory) -> type[asyncio.Protocol]:
    from freerein.serving.rest.websocket_protocol import BoundedWebSocketProtocol  # the extra [websocket]

    return type("LimitedWebSocketProtocol", (BoundedWebSocketProtocol,), {"limits": limits, "memory": memory})
