"""ASGI middleware of the REST API: request id, token, origin, size limits, and a record of each call."""

import re
import uuid
from collections.abc import Mapping
from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from freerein.errors import (
    Cancelled,
    MalformedRequest,
    RequestTimeout,
    ServiceError,
    TooLarge,
    UnsupportedMedia,
)
from freerein.serving import auth
from freerein.serving.call_recorder import CallRecorder
from freerein.serving.error_replies import problem_response
from freerein.serving.limits import COPIES, Limits
from freerein.serving.memory import Memory, Share
from freerein.serving.rest import docs_page, session
from freerein.serving.rest.origin_policy import OriginPolicy
from freerein.serving.rest.session import Session

MAX_HEADER_BYTES = 16 * 1024
REQUEST_ID = "freerein.request_id"
"""Key of the scope of a request for its id."""
SHARE = "freerein.memory"
"""Key of the scope of a request for its `Share` of the memory."""
LATE = "freerein.late"
"""Key of the scope of a request that did not arrive in time: how long it had, in seconds."""

_PATHS_OF_HEALTH = frozenset({"/healthz", "/readyz", "/v2/health/live", "/v2/health/ready"})
_MAX_HEADERS = 100
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


@dataclass(eq=False)
class RequestMiddleware:
    """Pure ASGI middleware around the whole app. `recorders` are by path; requests of no such path are `other`.

    Paths that begin with `assets` are there without the token. With a `session`, its cookie stands for the token.
    """

    app: ASGIApp
    limits: Limits
    memory: Memory
    token: str
    origin_policy: OriginPolicy
    recorders: Mapping[str, CallRecorder]
    other: CallRecorder
    assets: str | None = None
    session: Session | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serves one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        request_id = scope[REQUEST_ID] = _request_id(headers)
        reply = _Reply(send, request_id)
        recorder = self.recorders.get(scope["path"], self.other)
        try:
            with recorder.record(request_id) as call, self.memory.share() as share:
                self._check_headers(scope, headers)
                scope[SHARE] = share
                await self.app(scope, self._bounded(receive, scope, share), reply)
                if not reply.is_complete:
                    call.code = Cancelled.code
        except ServiceError as error:
            if not reply.has_begun:
                await problem_response(error, request_id)(scope, receive, reply)

    def _check_headers(self, scope: Scope, headers: Headers) -> None:
        size = len(scope["path"]) + len(scope["query_string"]) + sum(len(k) + len(v) for k, v in headers.raw)
        if len(headers) > _MAX_HEADERS or size > MAX_HEADER_BYTES:
            raise MalformedRequest(
                f"A request may have at most {_MAX_HEADERS} headers, and {MAX_HEADER_BYTES // 1024} KiB of headers and "
                "URL; got more.",
                hint="Send long values in the body.",
            )
        if scope["path"] not in _PATHS_OF_HEALTH:
            if not self._is_open(scope["path"]):
                self._authenticate(headers, reads=scope["method"] in ("GET", "HEAD"))
            self.origin_policy.check(headers)
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
        if int(length[:20]) > self.limits.message_bytes:
            raise self._too_large()
        if scope["method"] in ("GET", "HEAD") and (int(length[:20]) or "transfer-encoding" in headers):
            raise MalformedRequest("A request by GET must have no body; it has one.", hint="Send values in the query.")

    def _is_open(self, path: str) -> bool:
        """Returns whether a path is there without the token."""
        of_page = self.assets is not None and path.startswith(self.assets)
        return path in docs_page.PATHS or of_page or (self.session is not None and path == session.PATH)

    def _authenticate(self, headers: Headers, *, reads: bool) -> None:
        if self.session is not None and "authorization" not in headers and self.session.is_in(headers):
            self.origin_policy.check_session(headers, reads=reads)
        else:
            auth.check(headers.get("authorization", ""), self.token)

    def _bounded(self, receive: Receive, scope: Scope, share: Share) -> Receive:
        """Returns a `receive` that raises an error as soon as the body exceeds a size limit, or is late."""
        received = 0

        async def bounded_receive() -> Message:
            nonlocal received
            message = await receive()
            if LATE in scope:
                raise late_request(scope[LATE])
            size = len(message.get("body", b""))
            received += size
            if received > self.limits.message_bytes:
                raise self._too_large()
            share.take(COPIES * size)
            return message

        return bounded_receive

    def _too_large(self) -> TooLarge:
        return TooLarge(
            f"The body may have at most {self.limits.message_bytes} bytes; got more.", hint="Send less per call."
        )


class _Reply:
    """Wraps `send`, and adds the request id header.

    Attributes:
        has_begun: Whether the head of a response has been sent.
        is_complete: Whether the response has been sent to its end; else the client has left before.
    """

    def __init__(self, send: Send, request_id: str) -> None:
        self._send = send
        self._request_id = request_id
        self.has_begun = False
        self.is_complete = False

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.has_begun = True
            if b"x-request-id" not in dict(message["headers"]):
                message["headers"] = [*message["headers"], (b"x-request-id", self._request_id.encode())]
        await self._send(message)
        self.is_complete = message["type"] == "http.response.body" and not message.get("more_body", False)


def late_request(within_s: float) -> RequestTimeout:
    """Returns the error of a request that did not arrive in time."""
    return RequestTimeout(
        f"A request must arrive within {within_s:g} s; this one did not, so the service closes the connection.",
        hint="Send less per call, or raise FREEREIN_RECEIPT_S for slow lines.",
    )


def _request_id(headers: Headers) -> str:
    given = headers.get("x-request-id", "")
    return given if _REQUEST_ID.fullmatch(given) else uuid.uuid4().hex
