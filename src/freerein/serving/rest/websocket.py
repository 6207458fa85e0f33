"""The WebSocket of a service, at `/` of its REST port: binary messages in, each answered by one, in order.

A message that is refused is answered by a text, which openpi's client raises. What is refused before the first message
is a problem document if the service refuses it to anyone (token, limits), else a close frame with the reason.
"""

import asyncio
import uuid
from collections.abc import Awaitable, Callable, Sequence
from typing import Protocol

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from freerein.errors import Cancelled, DeadlineExceeded, MalformedRequest, NotFound, ServiceError
from freerein.serving import auth
from freerein.serving.call_recorder import CallRecorder
from freerein.serving.error_replies import close_reason, error_line, problem_response
from freerein.serving.health import Health
from freerein.serving.limits import Limits, Slots
from freerein.serving.metrics import Metrics
from freerein.serving.rest.origin_policy import OriginPolicy

PATH = "/"
ABOUT = (
    "robots with `openpi-client` connect there, such as `ws://HOST:PORT/?model.name=NAME&goal.text=TEXT`. Messages are "
    "msgpack: the service sends the model's spec, then answers each observation by actions. Keys of an observation and "
    "of the URL are in docs/protocol.md, under Robots with openpi's client."
)
"""The WebSocket in the description of the API."""
ERROR = "freerein.error"
"""Key of the event that ends a connection for the error that it was closed with, where the client broke a rule."""
_CLOSE_CODES = {"internal": 1011, "unavailable": 1012, "overloaded": 1013}
_CLEAN_CODES = (1000, 1001)
_VIOLATION = 1008


class MessageSession(Protocol):
    """One connection as the service sees it."""

    @property
    def greeting(self) -> bytes:
        """The message that is sent first."""

    async def answer(self, message: bytes) -> bytes:
        """Returns the reply to a message; raises ServiceError when it is refused."""


OpenSession = Callable[[Sequence[tuple[str, str]]], Awaitable[MessageSession]]
"""Opens a connection for the query of its URL; raises ServiceError when it is refused."""


class WebSocketEndpoint:
    """Serves connections. An empty `token` allows every one."""

    def __init__(
        self,
        open_session: OpenSession,
        *,
        health: Health,
        metrics: Metrics,
        limits: Limits,
        token: str,
        origin_policy: OriginPolicy,
    ) -> None:
        self._open_session = open_session
        self._health = health
        self._recorder = CallRecorder(metrics, "websocket", PATH, is_stream=True)
        self._limits = limits
        self._token = token
        self._origin_policy = origin_policy
        self._slots = Slots(limits.streams, "WebSockets may be open")

    async def serve(self, socket: WebSocket) -> None:
        """Serves one connection until the client closes it, is silent for too long, or the service drains."""
        request_id = uuid.uuid4().hex
        try:
            with self._recorder.record(request_id) as call:
                try:
                    await self._serve(socket, request_id)
                except WebSocketDisconnect:  # nobody is there to be told
                    call.code = Cancelled.code
        except ServiceError as error:
            await _refuse(socket, error, request_id)

    async def refuse_path(self, socket: WebSocket) -> None:
        """Refuses a connection at another path, and says which is right."""
        error: ServiceError = NotFound(
            f"The WebSocket of this service is at `{PATH}`; the URL has another path.",
            hint=f"Connect to ws://HOST:PORT{PATH} instead, with the same query.",
        )
        try:
            self._check(socket)
        except ServiceError as refusal:
            error = refusal
        await _refuse(socket, error, uuid.uuid4().hex)

    async def _serve(self, socket: WebSocket, request_id: str) -> None:
        self._check(socket)
        with self._slots.hold():
            await socket.accept(headers=[(b"x-request-id", request_id.encode())])
            session = await self._open_session(socket.query_params.multi_items())
            await self._send(socket, session.greeting)
            while (message := await self._receive(socket)) is not None:
                await self._send(socket, await _reply(session, message, request_id))

    def _check(self, socket: WebSocket) -> None:
        if self._health.draining:
            raise self._health.error()
        auth.check(socket.headers.get("authorization", ""), self._token)
        self._origin_policy.check(socket.headers)

    async def _receive(self, socket: WebSocket) -> bytes | str | None:
        """Returns the next message; None when the client has closed the connection."""
        try:
            async with asyncio.timeout(self._limits.idle_s):
                event = await self._health.await_or_drain(socket.receive())
        except TimeoutError:
            raise DeadlineExceeded(
                f"A message must come within {self._limits.idle_s:g} s; none came.", hint="Connect again."
            ) from None
        if event is None:
            raise self._health.error()
        if ERROR in event:
            raise event[ERROR]
        if event["type"] == "websocket.disconnect":
            if event["code"] not in _CLEAN_CODES:
                raise WebSocketDisconnect(event["code"])
            return None
        message: bytes | str = event["text"] if event.get("bytes") is None else event["bytes"]
        return message

    async def _send(self, socket: WebSocket, message: bytes | str) -> None:
        try:
            async with asyncio.timeout(self._limits.write_s):
                await (socket.send_text(message) if isinstance(message, str) else socket.send_bytes(message))
        except TimeoutError:
            raise WebSocketDisconnect(1006) from None


async def _reply(session: MessageSession, message: bytes | str, request_id: str) -> bytes | str:
    """Returns the reply to a message, a text when it is refused."""
    try:
        if isinstance(message, str):
            raise MalformedRequest("A message must be binary; it is a text.", hint="Send what the client packs.")
        return await session.answer(message)
    except ServiceError as error:
        return error_line(error, request_id)


async def _refuse(socket: WebSocket, error: ServiceError, request_id: str) -> None:
    """Ends a connection with an error: a problem document instead of it, or a close frame."""
    try:
        if socket.application_state is WebSocketState.CONNECTING:
            await socket.send_denial_response(problem_response(error, request_id))
        else:
            await socket.close(_CLOSE_CODES.get(error.code, _VIOLATION), close_reason(error))
    except (WebSocketDisconnect, ServiceError):  # the client is gone, or was told already
        pass
