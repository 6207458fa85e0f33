"""What every HTTP request passes first, before its body is read: id, token, sizes, one log line, metrics."""

import logging
import re
import time
import uuid
from collections.abc import Set
from typing import Any

import structlog
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from freerein.errors import Cancelled, Internal, MalformedRequest, Overloaded, ServiceError, TooLarge, UnsupportedMedia
from freerein.serving import auth, problems
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics

_log = logging.getLogger(__name__)
_OPEN_PATHS = frozenset({"/healthz", "/readyz", "/v2/health/live", "/v2/health/ready"})
_HEADERS = 100
HEADER_BYTES = 16 * 1024
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


class Edge:
    """Pure ASGI middleware around the whole app.

    Args:
        app: What it guards.
        metrics: Where calls are counted.
        limits: The bounds.
        token: Bearer token that calls must carry; empty for none.
        paths: Known paths: the only ones that become labels of metrics.
    """

    def __init__(self, app: ASGIApp, *, metrics: Metrics, limits: Limits, token: str, paths: Set[str]) -> None:
        self._app = app
        self._metrics = metrics
        self._limits = limits
        self._token = token
        self._paths = paths
        self._buffered = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serves one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started = time.perf_counter()
        headers = Headers(scope=scope)
        request_id = scope["freerein.request_id"] = _request_id(headers)
        reply = _Reply(send, request_id)
        with (
            structlog.contextvars.bound_contextvars(request_id=request_id),
            self._metrics.in_flight.labels("rest").track_inprogress(),
        ):
            try:
                self._admit(scope, headers)
                await self._bounded(scope, receive, reply)
            except ServiceError as error:
                scope["freerein.code"] = error.code
                await reply.problem(error)
            except Exception:  # every other exception is a bug
                scope["freerein.code"] = Internal.code
                _log.exception("bug", extra={"route": scope["path"] if scope["path"] in self._paths else "other"})
                if reply.status:
                    raise
                bug = Internal("A bug of ours; the log says more.", hint="Report it with the request id.")
                await reply.problem(bug)
            finally:
                self._record(scope, reply.status, time.perf_counter() - started)

    def _admit(self, scope: Scope, headers: Headers) -> None:
        size = len(scope["path"]) + len(scope["query_string"]) + sum(len(k) + len(v) for k, v in headers.raw)
        if len(headers) > _HEADERS or size > HEADER_BYTES:
            raise MalformedRequest(
                f"A request may have at most {_HEADERS} headers and {HEADER_BYTES // 1024} KiB of them and of its URL; "
                "it has more.",
                hint="Send what is long in the body.",
            )
        if scope["path"] not in _OPEN_PATHS:
            auth.check(headers.get("authorization", ""), self._token)
        if headers.get("content-encoding", "identity").lower() != "identity":
            raise UnsupportedMedia(
                "The body must come without Content-Encoding; it names one.", hint="Send it uncompressed."
            )
        if "content-length" in headers and "transfer-encoding" in headers:
            raise MalformedRequest("A body has one length; two headers tell of it.", hint="Leave it to the client.")
        length = headers.get("content-length", "0")
        if not length.isascii() or not length.isdecimal():
            raise MalformedRequest(
                "Content-Length must be a number of bytes; it is not.", hint="Leave it to the client."
            )
        if int(length[:20]) > self._limits.message_bytes:
            raise self._too_large()

    async def _bounded(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Runs the app with a body that ends in an error as soon as it is over a limit."""
        received = 0

        async def bounded_receive() -> Message:
            nonlocal received
            message = await receive()
            size = len(message.get("body", b""))
            received += size
            self._buffered += size
            if received > self._limits.message_bytes:
                raise self._too_large()
            if self._buffered > self._limits.buffered_bytes:
                raise Overloaded("The service holds as many bodies as it may.", hint="Try again after Retry-After.")
            return message

        try:
            await self._app(scope, bounded_receive, send)
        finally:
            self._buffered -= received

    def _too_large(self) -> TooLarge:
        return TooLarge(
            f"The body may have at most {self._limits.message_bytes} bytes; it has more.", hint="Send less per call."
        )

    def _record(self, scope: Scope, status: int, seconds: float) -> None:
        path = scope["path"] if scope["path"] in self._paths else "other"
        code = scope.get("freerein.code", _code(status))
        self._metrics.calls.labels("rest", path, code).inc()
        self._metrics.latency.labels("rest", path).observe(seconds)
        if code == "cancelled":
            self._metrics.cancelled.labels("rest").inc()
        if path != "other":
            _log.info("request", extra=_fields(scope["method"], path, status, seconds))


def _code(status: int) -> str:
    """Returns the code of a reply that no `ServiceError` gave; status 0 is none: the server stopped first."""
    if not status:
        return Cancelled.code
    return "ok" if status < 400 else "other"


def _fields(method: str, path: str, status: int, seconds: float) -> dict[str, Any]:
    return {"method": method, "route": path, "status": status, "ms": round(seconds * 1e3, 3)}


class _Reply:
    """The response as it leaves: remembers its status, carries the request id, begins once."""

    def __init__(self, send: Send, request_id: str) -> None:
        self._send = send
        self._request_id = request_id
        self.status = 0

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
            names = {name for name, _ in message["headers"]}
            if b"x-request-id" not in names:
                message["headers"] = [*message["headers"], (b"x-request-id", self._request_id.encode())]
        await self._send(message)

    async def problem(self, error: ServiceError) -> None:
        if self.status:
            return  # too late: the reply has begun
        headers = [(k.encode(), v.encode()) for k, v in problems.headers(error, self._request_id).items()]
        await self({"type": "http.response.start", "status": error.http_status, "headers": headers})
        await self({"type": "http.response.body", "body": problems.document(error, self._request_id)})


def _request_id(headers: Headers) -> str:
    given = headers.get("x-request-id", "")
    return given if _REQUEST_ID.fullmatch(given) else uuid.uuid4().hex
