"""Replies over REST: large ones are encoded off the event loop, sent in pieces, and count until they are read."""

import asyncio
import base64
import threading
from typing import Any

import httpx
import orjson
import pytest
from starlette.types import Message

from freerein.api.sim.v1 import sim_pb2
from freerein.serving.health import Health
from freerein.serving.limits import COPIES, MAX_INLINE_BYTES, Limits
from freerein.serving.memory import Memory
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein.serving.rest import app as rest
from freerein.serving.rest import reply_parts
from freerein.types.sim import SnapshotRequest, SnapshotResponse

pytestmark = pytest.mark.fault("F13")
BYTES = 1_000_000
BODY = b'{"session": "a"}'


class Core:
    """Replies with zeros."""

    size = BYTES

    def __getattr__(self, name: str) -> Any:
        return None  # the calls that these tests do not make

    async def snapshot(self, _request: SnapshotRequest) -> SnapshotResponse:
        return SnapshotResponse(bytes(self.size))


def make_toy(core: Core, memory: Memory) -> Any:
    methods = methods_of(sim_pb2.DESCRIPTOR.services_by_name["SimService"], core)
    return rest.make_app("toy", methods, health=Health(), metrics=Metrics(), limits=Limits(), memory=memory)


class Call:
    """A call of `Snapshot` whose client takes the reply piece by piece.

    Attributes:
        pieces: What it has taken.
        offered: Given a permit for each piece that is offered.
        taken: Given a permit to take a piece.
    """

    def __init__(self, app: Any) -> None:
        self.pieces: list[Message] = []
        self.offered, self.taken = asyncio.Semaphore(0), asyncio.Semaphore(0)
        headers = [(b"content-type", b"application/json")]
        scope = {"type": "http", "method": "POST", "path": "/v1/snapshot", "query_string": b"", "headers": headers}
        self._body = [{"type": "http.request", "body": BODY}]
        self.task = asyncio.create_task(app({**scope, "asgi": {"spec_version": "2.3"}}, self._receive, self._send))

    async def _receive(self) -> Message:
        if not self._body:
            await asyncio.Event().wait()
        return self._body.pop()

    async def _send(self, message: Message) -> None:
        self.offered.release()
        await self.taken.acquire()
        self.pieces.append(message)


async def ask(app: Any) -> httpx.Response:
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://x") as client:
        return await client.post("/v1/snapshot", content=BODY, headers={"content-type": "application/json"})


async def test_a_large_reply_is_whole_and_comes_in_pieces() -> None:
    memory = Memory(Limits())
    call = Call(make_toy(Core(), memory))
    for _ in range(100):
        call.taken.release()
    await asyncio.wait_for(call.task, 60)
    start, *pieces = call.pieces
    assert len(pieces) > 4
    assert [piece["more_body"] for piece in pieces] == [True] * (len(pieces) - 1) + [False]
    body = b"".join(piece["body"] for piece in pieces)
    assert dict(start["headers"])[b"content-length"] == b"%d" % len(body)
    assert orjson.loads(body) == {"snapshot": base64.b64encode(bytes(BYTES)).decode()}
    assert memory.taken == 0


async def test_a_reply_counts_until_it_is_read() -> None:
    memory = Memory(Limits(buffered_bytes=4 * BYTES))
    app = make_toy(Core(), memory)
    unread = Call(app)
    for _ in range(3):
        await asyncio.wait_for(unread.offered.acquire(), 60)
        assert memory.taken == COPIES * (BYTES + len(BODY))
        unread.taken.release()
    refused = await ask(app)
    assert (refused.status_code, refused.json()["code"]) == (429, "overloaded")
    for _ in range(100):
        unread.taken.release()
    await asyncio.wait_for(unread.task, 60)
    assert (await ask(app)).status_code == 200
    assert memory.taken == 0


async def test_very_large_replies_are_encoded_one_at_a_time_and_never_joined(monkeypatch: pytest.MonkeyPatch) -> None:
    core, busy, lengths, real = Core(), threading.Lock(), [], reply_parts.b64encode
    core.size = 9 * 2**20

    def recorded(part: bytes) -> bytes:
        assert busy.acquire(blocking=False)
        try:
            lengths.append(len(part))
            return real(part)
        finally:
            busy.release()

    monkeypatch.setattr(reply_parts, "b64encode", recorded)
    app = make_toy(core, Memory(Limits()))
    for reply in await asyncio.gather(*(ask(app) for _ in range(3))):
        assert base64.b64decode(reply.json()["snapshot"]) == bytes(core.size)
    assert {*lengths} == {192 * 1024}
    assert sum(lengths) == 3 * core.size


@pytest.mark.parametrize(("size", "is_inline"), [(MAX_INLINE_BYTES, True), (MAX_INLINE_BYTES + 1, False)])
async def test_large_replies_are_encoded_off_the_event_loop(
    size: int, is_inline: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    core, threads, real = Core(), [], orjson.dumps
    core.size = size

    def recorded(*arguments: Any) -> bytes:
        threads.append(threading.current_thread())
        return real(*arguments)

    monkeypatch.setattr(orjson, "dumps", recorded)
    assert (await ask(make_toy(core, Memory(Limits())))).status_code == 200
    assert (threads == [threading.current_thread()]) == is_inline
