"""uvicorn with what it lacks: a deadline for receiving a request, one for reading a reply, and an exit code of 0."""

import asyncio
import uuid
from typing import Any, ClassVar

import h11
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from freerein.errors import MalformedRequest, ServiceError
from freerein.serving import problems
from freerein.serving.edge import HEADER_BYTES
from freerein.serving.health import Health
from freerein.serving.limits import Limits


class DeadlineProtocol(H11Protocol):
    """Closes a connection that sends its request, or reads its reply, too slowly, or sends nothing at all."""

    limits: ClassVar[Limits]
    _receipt: asyncio.TimerHandle | None = None
    _write: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's
        """Begins to wait for a request."""
        super().connection_made(transport)
        self._await_request()

    def data_received(self, data: bytes) -> None:
        """Begins to wait for the rest of a request, unless that has begun."""
        self._await_request()
        super().data_received(data)

    def handle_events(self) -> None:
        """Waits no longer once a request is there whole."""
        super().handle_events()
        if self.conn.their_state is h11.SEND_BODY:
            self._await_request()
        elif self.conn.their_state is not h11.IDLE:  # a whole request is there
            _cancel(self._receipt)
            self._receipt = None

    def pause_writing(self) -> None:
        """Begins to wait for the reader."""
        super().pause_writing()
        self._await_reader()

    def resume_writing(self) -> None:
        """Waits no longer for the reader."""
        super().resume_writing()
        _cancel(self._write)
        self._write = None

    def on_response_complete(self) -> None:
        """Begins to wait until the reader has taken the rest."""
        super().on_response_complete()
        self._await_reader()

    def connection_lost(self, exc: Exception | None) -> None:
        """Waits for nothing any more."""
        _cancel(self._receipt)
        super().connection_lost(exc)
        _cancel(self._write)

    def send_400_response(self, msg: str) -> None:
        """Answers what is no HTTP as everything else is answered."""
        error = MalformedRequest(
            "The bytes must be an HTTP/1.1 request with headers of at most 16 KiB; they are not.",
            hint="Let an HTTP client write them.",
        )
        if self.cycle is None or self.cycle.response_complete or not self.cycle.response_started:
            self.transport.write(_response(error))
        self.transport.close()

    def _await_request(self) -> None:
        self._receipt = self._receipt or self.loop.call_later(self.limits.receipt_s, self.transport.abort)

    def _await_reader(self) -> None:
        self._write = self._write or self.loop.call_later(self.limits.write_s, self._end_unread)

    def _end_unread(self) -> None:
        self._write = None
        if self.transport.get_write_buffer_size():
            self.transport.abort()


def protocol_class(limits: Limits) -> type[DeadlineProtocol]:
    """Returns the HTTP/1.1 protocol with the deadlines of `limits`."""
    return type("LimitedProtocol", (DeadlineProtocol,), {"limits": limits})


def _response(error: ServiceError) -> bytes:
    """Returns the bytes of a reply to what is no request."""
    request_id = uuid.uuid4().hex
    body, headers = problems.document(error, request_id), problems.headers(error, request_id)
    lines = [f"HTTP/1.1 {error.http_status} ", *(f"{key}: {value}" for key, value in headers.items())]
    return "\r\n".join([*lines, f"content-length: {len(body)}", "", ""]).encode() + body


class Server(uvicorn.Server):
    """A uvicorn that, told to stop, first says so to `health`, and then ends with exit code 0."""

    def __init__(self, config: uvicorn.Config, health: Health) -> None:
        super().__init__(config)
        self._health = health

    def handle_exit(self, sig: int, frame: Any) -> None:
        """Begins the drain. The signal is not kept, so that uvicorn does not raise it again at the end."""
        self._health.drain()
        self.should_exit = True


def make_server(app: Any, *, limits: Limits, health: Health, cert: str | None, key: str | None) -> Server:
    """Returns the server of the REST door; `serve(sockets=[...])` runs it."""
    config = uvicorn.Config(
        app,
        http=protocol_class(limits),
        ws="none",
        lifespan="off",
        access_log=False,
        log_config=None,
        server_header=False,
        h11_max_incomplete_event_size=HEADER_BYTES,
        timeout_graceful_shutdown=int(limits.drain_s),
        ssl_certfile=cert,
        ssl_keyfile=key,
    )
    return Server(config, health)


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
