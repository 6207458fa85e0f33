"""uvicorn with what it lacks: a deadline for receiving a request, one for reading a reply, and an exit code of 0."""

import asyncio
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from freerein.errors import MalformedRequest
from freerein.serving import problems
from freerein.serving.health import Health
from freerein.serving.limits import Limits

_HEADER_BYTES = 16 * 1024


def protocol_class(limits: Limits) -> type[asyncio.Protocol]:
    """Returns the HTTP/1.1 protocol with the deadlines of `limits`."""

    class DeadlineProtocol(H11Protocol):
        """Closes a connection that sends its request, or reads its reply, too slowly, or sends nothing at all."""

        _receipt: asyncio.TimerHandle | None = None
        _write: asyncio.TimerHandle | None = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's
            super().connection_made(transport)
            self._receipt = self.loop.call_later(limits.receipt_s, transport.abort)

        def data_received(self, data: bytes) -> None:
            if self._receipt is None:
                self._receipt = self.loop.call_later(limits.receipt_s, self.transport.abort)
            super().data_received(data)

        def handle_events(self) -> None:
            super().handle_events()
            if self.cycle is not None and not self.cycle.more_body:
                _cancel(self._receipt)
                self._receipt = None

        def pause_writing(self) -> None:
            super().pause_writing()
            self._write = self._write or self.loop.call_later(limits.write_s, self.transport.abort)

        def resume_writing(self) -> None:
            super().resume_writing()
            _cancel(self._write)
            self._write = None

        def connection_lost(self, exc: Exception | None) -> None:
            _cancel(self._receipt)
            _cancel(self._write)
            super().connection_lost(exc)

        def send_400_response(self, msg: str) -> None:
            error = MalformedRequest(
                "The bytes must be an HTTP/1.1 request with headers of at most 16 KiB; they are not."
            )
            body = problems.document(error, "")
            self.transport.write(
                b"HTTP/1.1 400 Bad Request\r\ncontent-type: %s\r\ncontent-length: %d\r\nconnection: close\r\n\r\n%s"
                % (problems.MEDIA_TYPE.encode(), len(body), body)
            )
            self.transport.close()

    return DeadlineProtocol


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
        h11_max_incomplete_event_size=_HEADER_BYTES,
        timeout_graceful_shutdown=int(limits.drain_s),
        ssl_certfile=cert,
        ssl_keyfile=key,
    )
    return Server(config, health)


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
