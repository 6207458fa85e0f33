"""uvicorn with deadlines for handshakes, requests and replies, no tiny chunks, and exit code 0 on SIGTERM."""

import asyncio
import socket
import uuid
from collections.abc import Collection
from typing import Any, ClassVar

import uvicorn
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from freerein.errors import MalformedRequest
from freerein.serving.error_replies import problem_document, problem_headers
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.rest.middleware import MAX_HEADER_BYTES

MOST_PIPELINED = 256
"""Requests on a connection that wait for the reply to an earlier one; each takes kilobytes."""

_MIN_MEAN_CHUNK_BYTES = 64
_MIN_BYTES_IN_CHUNKS = 16 * 1024  # fewer may come in chunks of any size


class _PipelineFlow(FlowControl):
    """Reads on only when no request waits for the reply to the one before it."""

    def __init__(self, transport: asyncio.Transport, pipeline: Collection[object]) -> None:
        super().__init__(transport)
        self._pipeline = pipeline

    def resume_reading(self) -> None:
        """Reads on, unless a request waits; then its turn does."""
        if not self._pipeline:
            super().resume_reading()


class DeadlineProtocol(HttpToolsProtocol):
    """Closes a connection whose client sends its request, or reads its reply, too slowly, or sends nothing.

    It also closes one that sends bodies in tiny chunks, since the time to parse grows with their number, and one whose
    headers, or trailers, do not end. It counts HTTP chunks. TCP segments are not counted: they are merged while the
    parser is busy. Requests that are sent before the reply to another one wait, and no more is read meanwhile.
    """

    limits: ClassVar[Limits]
    _receive_timer: asyncio.TimerHandle | None = None
    _write_timer: asyncio.TimerHandle | None = None
    _answered: RequestResponseCycle | None = None  # whose reply is being written, or was last; `cycle` came last
    _is_receiving = False  # a request that has begun and not ended
    _in_head = True
    _chunks = _body_bytes = _head_bytes = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's
        """Starts the receive deadline."""
        super().connection_made(transport)
        self.flow = _PipelineFlow(transport, self.pipeline)
        self._start_receive_timer()

    def data_received(self, data: bytes) -> None:
        """Starts the receive deadline, unless it runs already; refuses a head that is too long."""
        self._start_receive_timer()
        self._head_bytes += len(data)
        super().data_received(data)
        if not self._is_receiving and self._open_cycle() is not None:
            self._stop_receive_timer()  # these bytes were the end of a request, or lines between two
        if self._head_bytes > MAX_HEADER_BYTES and not self.transport.is_closing():  # the parser would keep them all
            self.send_400_response("")

    def on_message_begin(self) -> None:
        """Begins a request."""
        super().on_message_begin()
        self._is_receiving = self._in_head = True
        self._chunks = self._body_bytes = self._head_bytes = 0

    def on_header(self, name: bytes, value: bytes) -> None:
        """Takes a header. Trailers are read over: they would become headers of a request that is being answered."""
        if self._in_head:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Ends the head. A request that waits for the reply to the one before it has no deadline."""
        self._in_head, self._head_bytes = False, 0
        if [name for name, _ in self.headers].count(b"host") != 1 and self.parser.get_http_version() == "1.1":
            raise ValueError("a request must have one Host")
        if len(self.pipeline) >= MOST_PIPELINED:
            raise ValueError("too many requests wait")
        super().on_headers_complete()
        if self.pipeline:
            self._stop_receive_timer()

    def on_chunk_header(self) -> None:
        """Counts a chunk; raises where the mean of those before is too small. The last one may be small."""
        if _MIN_BYTES_IN_CHUNKS < self._body_bytes < _MIN_MEAN_CHUNK_BYTES * (self._chunks - 1):
            raise ValueError("the chunks are too small")
        self._chunks += 1

    def on_body(self, body: bytes) -> None:
        """Takes a part of the body."""
        self._body_bytes += len(body)
        self._head_bytes = 0
        super().on_body(body)

    def on_message_complete(self) -> None:
        """Stops the receive deadline: the whole request has arrived."""
        super().on_message_complete()
        self._is_receiving, self._head_bytes = False, 0
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
        """Starts the write deadline for what is still in the transport's buffer."""
        super().on_response_complete()
        if self._is_receiving:
            self._start_receive_timer()
        if self.transport.get_write_buffer_size():
            self._start_write_timer()

    def handle_websocket_upgrade(self) -> None:
        """Stops both deadlines: from here on another protocol has the connection."""
        self._stop_receive_timer()
        self._stop_write_timer()
        super().handle_websocket_upgrade()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stops both deadlines, and tells whoever answers: uvicorn tells the request that came last alone."""
        self._stop_receive_timer()
        if (cycle := self._open_cycle()) is not None:
            cycle.disconnected = True
            cycle.message_event.set()
        super().connection_lost(exc)
        self._stop_write_timer()

    def send_400_response(self, msg: str) -> None:
        """Answers bytes that are not HTTP with a problem document, and closes the connection."""
        cycle = self._open_cycle()
        if not self.pipeline and (cycle is None or not cycle.response_started):
            self.transport.write(_bad_request())
        self.transport.close()
        self._start_write_timer()

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: Any) -> None:
        self._answered = cycle
        super()._start_asgi_task(cycle, app)

    def _open_cycle(self) -> RequestResponseCycle | None:
        """Returns the request whose reply is not complete, None when there is none."""
        return None if self._answered is None or self._answered.response_complete else self._answered

    def _start_receive_timer(self) -> None:
        if self._receive_timer is None:
            self._receive_timer = self.loop.call_later(self.limits.receipt_s, self.transport.abort)

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
    request_id = uuid.uuid4().hex
    error = MalformedRequest(
        "The bytes must be an HTTP/1.1 request with one Host, a method of HTTP, headers of at most 16 KiB, and chunks "
        f"of 64 bytes or more on average, and at most {MOST_PIPELINED} may wait for an answer; they are not.",
        hint="Use an HTTP client that sends large chunks, or Content-Length, and a request after the reply to another.",
    )
    body = problem_document(error, request_id)
    lines = [f"{key}: {value}" for key, value in problem_headers(error, request_id).items()]
    return "\r\n".join(["HTTP/1.1 400 ", *lines, f"content-length: {len(body)}", "", ""]).encode() + body


class HttpServer(uvicorn.Server):
    """A uvicorn server that, on a stop signal, marks the service as draining and ends with exit code 0."""

    def __init__(self, config: uvicorn.Config, health: Health, limits: Limits) -> None:
        super().__init__(config)
        self._health = health
        self._limits = limits

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
        self._health.drain()
        self.should_exit = True


def make_server(
    app: Any, *, limits: Limits, health: Health, cert: str | None, key: str | None, has_websocket: bool = False
) -> HttpServer:
    """Returns the HTTP server of the REST API; `serve(sockets=[...])` runs it."""
    config = uvicorn.Config(
        app,
        http=type("LimitedProtocol", (DeadlineProtocol,), {"limits": limits}),
        ws=_websocket_protocol(limits) if has_websocket else "none",
        ws_max_size=limits.websocket_bytes,
        ws_ping_interval=limits.ping_s,
        ws_ping_timeout=limits.ping_s,
        ws_per_message_deflate=False,
        lifespan="off",
        access_log=False,
        log_config=None,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=int(limits.drain_s),
        ssl_certfile=cert,
        ssl_keyfile=key,
    )
    return HttpServer(config, health, limits)


def _websocket_protocol(limits: Limits) -> type[asyncio.Protocol]:
    from freerein.serving.rest.websocket_protocol import BoundedWebSocketProtocol  # the extra [websocket]

    return type("LimitedWebSocketProtocol", (BoundedWebSocketProtocol,), {"limits": limits})
