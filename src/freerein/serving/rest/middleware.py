"""ASGI middleware of the REST API: request id, token, size limits, one log line and metrics per request."""

import logging
import re
import time
import uuid
from collections.abc import Set

import structlog
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from freerein.atomic_files import OUT_OF_FILES, out_of_files
from freerein.errors import (
    Cancelled,
    Internal,
    MalformedRequest,
    Overloaded,
    ServiceError,
    TooLarge,
    UnsupportedMedia,
)
from freerein.serving import auth
from freerein.serving.error_replies import internal_error, problem_document, problem_headers
from freerein.serving.limits import COPIES, Limits
from freerein.serving.metrics import Metrics

MAX_HEADER_BYTES = 16 * 1024

_log = logging.getLogger(__name__)
_PATHS_WITHOUT_TOKEN = frozenset({"/healthz", "/readyz", "/v2/health/live", "/v2/health/ready"})
_MAX_HEADERS = 100
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


class RequestMiddleware:
    """Pure ASGI middleware around the whole app; only known `paths` become metric labels."""

    def __init__(self, app: ASGIApp, *, metrics: Metrics, limits: Limits, token: str, paths: Set[str]) -> None:
        self._app = app
        self._metrics = metrics
        self._limits = limits
        self._token = token
        self._paths = paths
        self._buffered_bytes = 0

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
                self._check_headers(scope, headers)
                await self._run_app(scope, receive, reply)
            except ServiceError as error:
                scope["freerein.code"] = error.code
                await reply.problem(error)
            except Exception:  # every other exception is a bug
                scope["freerein.code"] = Internal.code
                _log.exception("bug", extra={"route": self._label(scope)})
                if reply.status:
                    raise
                await reply.problem(internal_error())
            finally:
                self._record(scope, reply.status, time.perf_counter() - started)

    def _check_headers(self, scope: Scope, headers: Headers) -> None:
        size = len(scope["path"]) + len(scope["query_string"]) + sum(len(k) + len(v) for k, v in headers.raw)
        if len(headers) > _MAX_HEADERS or size > MAX_HEADER_BYTES:
            raise MalformedRequest(
                f"A request may have at most {_MAX_HEADERS} headers, and {MAX_HEADER_BYTES // 1024} KiB of headers and "
                "URL; got more.",
                hint="Send long values in the body.",
            )
        if scope["path"] not in _PATHS_WITHOUT_TOKEN:
            auth.check(headers.get("authorization", ""), self._token)
        if headers.get("content-encoding", "identity").lower() != "identity":
            raise UnsupportedMedia(
                "The body must have no Content-Encoding; the header names one.", hint="Send the body uncompressed."
            )
        if "content-length" in headers and "transfer-encoding" in headers:
            raise MalformedRequest(
                "A request must have Content-Length or Transfer-Encoding; got both.",
                hint="Let the HTTP client set them.",
            )
        length = headers.get("content-length", "0")
        if not length.isascii() or not length.isdecimal():
            raise MalformedRequest(
                "Content-Length must be a number of bytes; got something else.", hint="Let the HTTP client set it."
            )
        if int(length[:20]) > self._limits.message_bytes:
            raise self._too_large()

    async def _run_app(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Runs the app; receiving the body raises an error as soon as a size limit is exceeded."""
        received = 0

        async def bounded_receive() -> Message:
            nonlocal received
            message = await receive()
            size = len(message.get("body", b""))
            received += size
            self._buffered_bytes += COPIES * size
            if received > self._limits.message_bytes:
                raise self._too_large()
            if self._buffered_bytes > self._limits.buffered_bytes:
                raise Overloaded(
                    f"Request bodies may take at most {self._limits.buffered_bytes} bytes of memory together, "
                    f"{COPIES} times their length; they would take more.",
                    hint="Retry after Retry-After, or send less per call.",
                )
            return message

        try:
            await self._app(scope, bounded_receive, send)
        except OSError as error:
            if error.errno not in OUT_OF_FILES:
                raise
            raise out_of_files() from None
        finally:
            self._buffered_bytes -= COPIES * received

    def _too_large(self) -> TooLarge:
        return TooLarge(
            f"The body may have at most {self._limits.message_bytes} bytes; got more.", hint="Send less per call."
        )

    def _label(self, scope: Scope) -> str:
        return scope["path"] if scope["path"] in self._paths else "other"

    def _record(self, scope: Scope, status: int, seconds: float) -> None:
        path, code = self._label(scope), scope.get("freerein.code", _code(status))
        self._metrics.calls.labels("rest", path, code).inc()
        self._metrics.latency.labels("rest", path).observe(seconds)
        if code == Cancelled.code:
            self._metrics.cancelled.labels("rest").inc()
        if path != "other":
            fields = {"method": scope["method"], "route": path, "status": status, "ms": round(seconds * 1e3, 3)}
            _log.info("request", extra=fields)


def _code(status: int) -> str:
    """Returns the code of a reply without a `ServiceError`; status 0 means that the server stopped first."""
    if not status:
        return Cancelled.code
    return "ok" if status < 400 else "other"


class _Reply:
    """Wraps `send`: records the status, adds the request id header, and sends at most one response."""

    def __init__(self, send: Send, request_id: str) -> None:
        self._send = send
        self._request_id = request_id
        self.status = 0

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
            if b"x-request-id" not in dict(message["headers"]):
                message["headers"] = [*message["headers"], (b"x-request-id", self._request_id.encode())]
        await self._send(message)

    async def problem(self, error: ServiceError) -> None:
        """Sends an error, unless the response has started already."""
        if self.status:
            return
        headers = [(k.encode(), v.encode()) for k, v in problem_headers(error, self._request_id).items()]
        await self({"type": "http.response.start", "status": error.http_status, "headers": headers})
        await self({"type": "http.response.body", "body": problem_document(error, self._request_id)})


def _request_id(headers: Headers) -> str:
    given = headers.get("x-request-id", "")
    return given if _REQUEST_ID.fullmatch(given) else uuid.uuid4().hex
