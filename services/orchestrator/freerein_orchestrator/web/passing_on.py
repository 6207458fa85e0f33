"""Passes calls of the page on to other services, at `/services/<name>/...`: a page may call its own origin alone.

A call is passed on as it is, and so are its reply and its errors; bodies are streamed both ways, never held. Each
service has its own bound of calls, so that one that hangs holds up no other.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AsyncExitStack, contextmanager

import httpx
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from freerein.errors import Cancelled, DeadlineExceeded, Unavailable
from freerein.serving.limits import Limits, Slots
from freerein.serving.methods import rest_path, rest_reads
from freerein.serving.rest.client_presence import HeldResponse, while_connected
from freerein.serving.rest.middleware import REQUEST_ID, SHARE
from freerein.stack.certificates import tls_context
from freerein_orchestrator.web.calls import ABOUT, CALLS

CALLS_AT_ONCE = 64
"""Calls in progress for each service."""

_CONNECT_S = 1.5
_LATE_S = 5.0  # after which a service that has not even answered that its time is up will not answer
_ASKED = ("accept", "content-type", "content-length", "last-event-id")
_ANSWERED = ("content-type", "content-length", "retry-after", "allow", "cache-control", "x-accel-buffering")


def make_client(limits: Limits, *, token: str, certificate: str | None) -> httpx.AsyncClient:
    """Returns the HTTP client of all services, which have the token and the certificate of this one."""
    return httpx.AsyncClient(
        headers={"authorization": f"Bearer {token}"} if token else {},
        limits=httpx.Limits(max_connections=None),
        timeout=httpx.Timeout(limits.unary_s + _LATE_S, connect=_CONNECT_S, write=limits.write_s),
        trust_env=False,
        verify=tls_context(certificate),
    )


class PassedOn:
    """The calls of one service that are passed on, each at `/services/<name>/<its path>`.

    Args:
        name: Name of the service.
        url: URL of its REST API.
        client: Where its calls are made.
    """

    def __init__(self, name: str, url: str, client: httpx.AsyncClient) -> None:
        self._name = name
        self._url = httpx.URL(url)
        self._client = client
        self._slots = Slots(CALLS_AT_ONCE, f"calls of pages to the {name} service may be in progress")

    @property
    def routes(self) -> Iterator[BaseRoute]:
        """The route of each call."""
        for path in ABOUT:
            yield self._route(path, "GET")
        for rpc in CALLS[self._name]:
            yield self._route(rest_path(rpc), "GET" if rest_reads(rpc) else "POST")

    def _route(self, path: str, method: str) -> BaseRoute:
        async def answer(request: Request) -> Response:
            async with AsyncExitStack() as resources:
                resources.enter_context(self._slots.hold())
                reply = await self._send(request, path)
                resources.push_async_callback(reply.aclose)
                self._check_token(reply)
                headers = {name: reply.headers[name] for name in _ANSWERED if name in reply.headers}
                if reply.status_code in (400, 408, 413):
                    headers["connection"] = "close"  # the end of this request's body is unknown, or still to come
                content = self._content(reply)
                return HeldResponse(content, resources.pop_all(), status_code=reply.status_code, headers=headers)

        return Route(f"/services/{self._name}{path}", answer, methods=[method])

    async def _send(self, request: Request, path: str) -> httpx.Response:
        """Returns the reply as soon as its head has arrived, unless the caller leaves before."""
        is_sent = asyncio.Event()
        has_body = request.method not in ("GET", "HEAD")
        if not has_body:
            is_sent.set()
        query = request.scope["query_string"]
        asked = self._client.build_request(
            request.method,
            self._url.copy_with(raw_path=path.encode() + (b"?" + query if query else b"")),
            headers={
                **{name: request.headers[name] for name in _ASKED if name in request.headers},
                "accept-encoding": "identity",
                "x-request-id": request.scope[REQUEST_ID],
            },
            content=_body(request, is_sent.set) if has_body else None,
        )
        async with while_connected(request, body_read=is_sent):
            with self._errors():
                return await self._client.send(asked, stream=True)

    def _check_token(self, reply: httpx.Response) -> None:
        """Raises Unavailable where the service has another token: a 401 would send the page to sign in again."""
        if reply.status_code == 401:
            raise Unavailable(
                f"The {self._name} service at {self._url} must have the token of the orchestrator; it has another.",
                hint="Start all services with the same FREEREIN_TOKEN.",
            )

    async def _content(self, reply: httpx.Response) -> AsyncIterator[bytes]:
        with self._errors():
            async for part in reply.aiter_raw():
                yield part

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Says which service did not answer, and what to do."""
        try:
            yield
        except ClientDisconnect:
            raise Cancelled("The client disconnected before the reply.") from None
        except (httpx.ConnectError, httpx.ConnectTimeout):
            raise Unavailable(
                f"The {self._name} service must run at {self._url}; it cannot be reached.",
                hint=f"Start it: freerein up {self._name}. Where it runs elsewhere, set "
                f"FREEREIN_{self._name.upper()}_URL of the orchestrator.",
            ) from None
        except httpx.TimeoutException:
            raise DeadlineExceeded(
                f"The {self._name} service at {self._url} must answer in time; it did not.",
                hint=f"Look at its log, and at `freerein doctor {self._name}`.",
            ) from None
        except httpx.TransportError:
            raise Unavailable(
                f"The {self._name} service at {self._url} must answer; it has ended the connection.",
                hint="Try again: it may have been started anew. Its log says more.",
            ) from None


async def _body(request: Request, on_end: Callable[[], None]) -> AsyncIterator[bytes]:
    """Yields the body of a request, and holds no part of it that has been sent."""
    async for part in request.stream():
        yield part
        request.scope[SHARE].resize(0)
    on_end()
