"""Streams over REST: each holds one of a bounded number of slots from its admission to its end."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from starlette.applications import Starlette

from freerein.api.learning.v1 import learning_pb2
from freerein.api.orchestrator.v1 import orchestrator_pb2
from freerein.errors import NotFound
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app
from freerein.types.learning import Fit, WatchFitResponse
from freerein.types.orchestrator import GetArtifactResponse

STREAMS = 2
EVENTS, FILE = "/v1/watch-fit", "/v1/get-artifact"
COMMENT = b":\n\n"
UNKNOWN = "1" * 32
FIT = Fit("0" * 32, "running", {}, dataset="demos", model_name="default")


class Core:
    """Streams one item, then nothing until they are closed; counts the streams that are open."""

    def __init__(self) -> None:
        self.open = 0

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return None  # the calls that these tests do not make

    @contextmanager
    def _counted(self) -> Iterator[None]:
        self.open += 1
        try:
            yield
        finally:
            self.open -= 1

    async def watch_fit(self, request: Any) -> AsyncIterator[WatchFitResponse]:
        with self._counted():
            if request.id == UNKNOWN:
                raise NotFound("There is no such fit.", field="id", hint="List them.")
            if request.id:
                yield WatchFitResponse(0, FIT)
            await asyncio.Event().wait()

    async def get_artifact(self, request: Any) -> AsyncIterator[GetArtifactResponse]:
        with self._counted():
            if request.id == UNKNOWN:
                raise NotFound("There is no such run.", field="id", hint="List them.")
            if request.id:
                yield GetArtifactResponse(b"part")
            await asyncio.Event().wait()


class Call:
    """One request to an ASGI app, whose client may leave, or take no byte of the reply.

    Attributes:
        body: What has arrived.
        status: The reply's status, 0 until it begins.
        headers: Its headers.
        asked: Set when the app waits for the first item, or for the client to leave.
        begun: Set when the reply begins.
        received: Set when the first part of the body arrives.
        commented: Set when two comments arrive, one after another.
        reading: Whether the client takes the reply.
    """

    def __init__(
        self, app: Starlette, path: str, *, run_id: str = "0" * 32, reads: bool = True, method: str = "GET"
    ) -> None:
        self.status, self.body = 0, b""
        self.headers: dict[bytes, bytes] = {}
        self.asked, self.begun, self.received = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self.commented = asyncio.Event()
        self.reading, self._gone = asyncio.Event(), asyncio.Event()
        if reads:
            self.reading.set()
        query = f"id={run_id}".encode()
        scope = {"type": "http", "method": method, "path": path, "query_string": query, "headers": []}
        self._task = asyncio.create_task(app({**scope, "asgi": {"spec_version": "2.3"}}, self._receive, self._send))

    async def _receive(self) -> dict[str, Any]:
        self.asked.set()
        await self._gone.wait()
        return {"type": "http.disconnect"}

    async def _send(self, message: Any) -> None:
        self.status = message.get("status", self.status)
        self.headers |= dict(message.get("headers", ()))
        self.begun.set()
        await self.reading.wait()
        if message.get("body"):
            self.body += message["body"]
            self.received.set()
        if self.body.endswith(2 * COMMENT):
            self.commented.set()

    async def end(self) -> None:
        """Returns when the app is done with the request."""
        await asyncio.wait_for(self._task, 60)

    async def leave(self) -> None:
        """Closes the connection; returns when the app is done with it."""
        self._gone.set()
        await self.end()


@pytest.fixture
def core() -> Core:
    return Core()


@pytest.fixture
def app(core: Core) -> Starlette:
    return make_toy(core, Limits(streams=STREAMS))


def make_toy(core: Core, limits: Limits) -> Starlette:
    contracts = learning_pb2.DESCRIPTOR.services_by_name, orchestrator_pb2.DESCRIPTOR.services_by_name
    methods = methods_of(contracts[0]["FitService"], core) + methods_of(contracts[1]["OrchestratorService"], core)
    return make_app("toy", methods, health=Health(), metrics=Metrics(), limits=limits)


async def soon(awaitable: Awaitable[Any]) -> None:
    await asyncio.wait_for(awaitable, 60)


@pytest.mark.parametrize("run_id", ["", "0" * 32], ids=["no event", "an event"])
async def test_a_stream_of_events_has_comments_where_it_has_no_events(core: Core, run_id: str) -> None:
    app = make_toy(core, Limits(keep_alive_s=0.01))
    call = Call(app, EVENTS, run_id=run_id)
    await soon(call.commented.wait())
    await call.leave()
    assert (call.status, call.body.count(b"id: 0\ndata: {"), core.open) == (200, bool(run_id), 0)


@pytest.mark.parametrize("method", ["GET", "HEAD"])
@pytest.mark.parametrize(("path", "is_unbuffered"), [(EVENTS, True), (FILE, False)])
async def test_a_proxy_is_told_to_hold_no_event_back(
    app: Starlette, path: str, is_unbuffered: bool, method: str
) -> None:
    call = Call(app, path, method=method)
    await soon(call.begun.wait())
    await call.leave()
    assert (call.headers.get(b"x-accel-buffering"), call.headers.get(b"cache-control")) == (
        (b"no", b"no-cache") if is_unbuffered else (None, None)
    )


@pytest.mark.parametrize("path", [EVENTS, FILE])
async def test_a_stream_above_the_limit_is_refused_at_once(app: Starlette, path: str) -> None:
    streams = [Call(app, path) for _ in range(STREAMS)]
    for stream in streams:
        await soon(stream.received.wait())
    for _ in range(2):
        refused = Call(app, path)
        await soon(refused.received.wait())
        assert refused.status == 429
    for stream in streams:
        await stream.leave()
    await soon(Call(app, path).received.wait())


@pytest.mark.parametrize(("run_id", "status"), [("0" * 32, 200), (UNKNOWN, 404)])
@pytest.mark.parametrize("path", [EVENTS, FILE])
async def test_a_request_for_the_head_of_a_stream_ends(
    app: Starlette, core: Core, path: str, run_id: str, status: int
) -> None:
    call = Call(app, path, run_id=run_id, method="HEAD")
    await call.end()
    assert (call.status, core.open) == (status, 0)


@pytest.mark.parametrize("path", [EVENTS, FILE])
async def test_a_stream_holds_its_slot_while_its_reply_begins(app: Starlette, path: str) -> None:
    slow = [Call(app, path, reads=False) for _ in range(STREAMS)]
    for stream in slow:
        await soon(stream.begun.wait())
    refused = Call(app, path)
    await soon(refused.received.wait())
    assert refused.status == 429
    for stream in slow:
        stream.reading.set()
        await soon(stream.received.wait())


async def leave_before_the_first_item(call: Call) -> None:
    await soon(call.asked.wait())
    await call.leave()


async def leave_before_the_body(call: Call) -> None:
    await soon(call.begun.wait())
    await call.leave()


async def leave_within_the_body(call: Call) -> None:
    await soon(call.received.wait())
    await call.leave()


@pytest.mark.parametrize("path", [EVENTS, FILE])
@pytest.mark.parametrize(
    ("run_id", "reads", "end"),
    [
        (UNKNOWN, True, leave_within_the_body),
        ("", True, leave_before_the_first_item),
        ("0" * 32, False, leave_before_the_body),
        ("0" * 32, True, leave_within_the_body),
    ],
    ids=["first item raises", "gone before first item", "gone before body", "gone within body"],
)
async def test_a_slot_is_released_once_however_its_stream_ends(
    app: Starlette, core: Core, path: str, run_id: str, reads: bool, end: Callable[[Call], Awaitable[None]]
) -> None:
    for _ in range(STREAMS + 1):
        await end(Call(app, path, run_id=run_id, reads=reads))
    assert core.open == 0
    open_now = [Call(app, path) for _ in range(STREAMS + 1)]
    for stream in open_now:
        await soon(stream.received.wait())
    assert sorted(stream.status for stream in open_now) == [200] * STREAMS + [429]
