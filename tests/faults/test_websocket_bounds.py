"""What one WebSocket may send, how fast, and what all may hold together: the protocol without a socket."""

import asyncio
import logging
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest
from uvicorn.server import ServerState

from freerein.serving.health import Health
from freerein.serving.limits import COPIES, Limits
from freerein.serving.memory import Memory
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app
from freerein.serving.rest.http_server import make_server

HANDSHAKE = (
    b"GET %s HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\n\r\n"
)
FRAGMENT, TEXT, BINARY, PING, PONG = 0, 1, 2, 9, 10
LIMITS = Limits(buffered_bytes=COPIES * 100_000)
QUICK = replace(LIMITS, receipt_s=0.1)


def frame(opcode: int, payload: bytes = b"", *, is_last: bool = True) -> bytes:
    """Returns a frame of a client, masked by zeros."""
    size = len(payload)
    long = struct.pack("!BH", 0x80 | 126, size) if size < 2**16 else struct.pack("!BQ", 0x80 | 127, size)
    length = bytes([0x80 | size]) if size < 126 else long
    return bytes([is_last << 7 | opcode]) + length + bytes(4) + payload


async def until(condition: Callable[[], bool]) -> None:
    """Returns once a condition holds."""
    async with asyncio.timeout(60):
        while not condition():  # noqa: ASYNC110  # nothing tells of it
            await asyncio.sleep(0)


class Session:
    """Answers each message by its length, when told to."""

    greeting = b"hello"

    def __init__(self) -> None:
        self.may_answer = asyncio.Event()
        self.may_answer.set()

    async def answer(self, message: bytes) -> bytes:
        await self.may_answer.wait()
        return b"%d bytes" % len(message)


class Client(asyncio.Transport):
    """The client's end of a connection.

    Attributes:
        heard: All that the service has sent.
        is_read: Whether the service reads.
        closed: Set when the service has closed the connection.
        aborted: Set when it has closed it whether or not all was read.
    """

    def __init__(self) -> None:
        super().__init__()
        self.heard = b""
        self.is_read = True
        self.closed, self.aborted = asyncio.Event(), asyncio.Event()

    def write(self, data: Any) -> None:
        self.heard += bytes(data)

    def pause_reading(self) -> None:
        self.is_read = False

    def resume_reading(self) -> None:
        self.is_read = True

    def is_closing(self) -> bool:
        return self.closed.is_set()

    def close(self) -> None:
        self.closed.set()

    def abort(self) -> None:
        self.closed.set()
        self.aborted.set()

    async def hears(self, words: bytes) -> None:
        """Returns once the service has said this."""
        await until(lambda: words in self.heard)

    async def is_told_to_close(self, code: int, reason: bytes) -> None:
        """Returns once a close frame with this code and start of the reason has come."""
        await self.hears(struct.pack("!H", code) + reason)


class Service:
    """One service with a WebSocket.

    Attributes:
        session: What all connections are answered by.
        memory: What they share.
    """

    def __init__(self, limits: Limits) -> None:
        self.session, self.memory = Session(), Memory(limits)

        async def open_session(_query: Any) -> Session:
            return self.session

        health = Health()
        app = make_app("toy", [], health=health, metrics=Metrics(), limits=limits, open_websocket=open_session)
        self._server = make_server(
            app, limits=limits, health=health, cert=None, key=None, memory=self.memory, has_websocket=True
        )
        self._server.config.load()

    @asynccontextmanager
    async def connection(self, path: bytes = b"/", *, accepted: bool = True) -> AsyncIterator[tuple[Any, Client]]:
        """A connection: the protocol, which is given what a client sends, and the client."""
        client, state = Client(), ServerState()
        protocol: Any = self._server.config.ws_protocol_class(  # type: ignore[misc]
            config=self._server.config, server_state=state, app_state={}
        )
        protocol.connection_made(client)
        protocol.data_received(HANDSHAKE % path)
        try:
            if accepted:
                await client.hears(b"hello")
            yield protocol, client
        finally:
            protocol.connection_lost(None)
            await asyncio.gather(*state.tasks)


CONTROL = {
    "pings": frame(PING),
    "pings with words": frame(PING, b"x" * 125),
    "pongs": frame(PONG),
    "messages": frame(BINARY, b"x"),
    "empty messages": frame(BINARY),
    "texts": frame(TEXT, b"x"),
}


@pytest.mark.fault("I20")
@pytest.mark.parametrize("one", CONTROL.values(), ids=CONTROL)
async def test_a_flood_of_frames_ends_its_connection(one: bytes) -> None:
    service = Service(LIMITS)
    service.session.may_answer.clear()
    async with service.connection() as (protocol, client):
        protocol.data_received(one * 3000)
        await client.is_told_to_close(1008, b"overloaded: Send messages whole, one by one. Frames besides answered")
        service.session.may_answer.set()
    assert service.memory.taken == 0


@pytest.mark.fault("I20")
async def test_as_many_messages_as_are_answered_are_no_flood() -> None:
    service = Service(LIMITS)
    async with service.connection() as (protocol, client):
        for length in range(3000):
            protocol.data_received(frame(BINARY, b"x" * (length % 100)))
            await client.hears(b"%d bytes" % (length % 100))
            client.heard = b""
        assert not client.closed.is_set()


@pytest.mark.fault("I20")
async def test_pongs_do_not_pile_up_for_a_client_that_does_not_read() -> None:
    async with Service(LIMITS).connection() as (protocol, client):
        protocol.pause_writing()
        before = client.heard
        protocol.data_received(frame(PING, b"x" * 125) * 1000)
        assert client.heard == before
        protocol.resume_writing()
        protocol.data_received(frame(PING, b"once"))
        assert client.heard.count(b"once") == 1


PARTIAL = {
    "half a frame": frame(BINARY, b"x" * 1000)[:500],
    "a byte": b"\x82",
    "fragments": frame(BINARY, b"x" * 500, is_last=False) + frame(FRAGMENT, b"x", is_last=False),
    "empty fragments": frame(BINARY, is_last=False),
    "half a text": frame(TEXT, b"x" * 1000)[:500],
}


@pytest.mark.fault("I21")
@pytest.mark.parametrize("part", PARTIAL.values(), ids=PARTIAL)
async def test_a_message_that_never_ends_ends_its_connection(part: bytes) -> None:
    service = Service(QUICK)
    async with service.connection() as (protocol, client):
        protocol.data_received(frame(BINARY, b"abc") + part)
        await client.is_told_to_close(1008, b"deadline_exceeded: Send less, or raise FREEREIN_RECEIPT_S.")
    assert service.memory.taken == 0


@pytest.mark.fault("I21")
async def test_a_message_has_no_deadline_while_the_service_reads_none() -> None:
    service = Service(QUICK)
    service.session.may_answer.clear()
    async with service.connection() as (protocol, client):
        whole = frame(BINARY, b"x" * 1000)
        protocol.data_received(frame(BINARY, b"one") + frame(BINARY, b"second") + whole[:500])
        await until(lambda: not client.is_read)
        assert protocol._receipt_timer is None
        service.session.may_answer.set()
        await client.hears(b"6 bytes")
        protocol.data_received(whole[500:])
        await client.hears(b"1000 bytes")


@pytest.mark.fault("F13")
@pytest.mark.parametrize("size", [50_000, 100_000])
async def test_messages_count_in_the_memory_for_all_until_they_are_answered(size: int) -> None:
    service = Service(LIMITS)
    service.session.may_answer.clear()
    async with service.connection() as (protocol, client):
        protocol.data_received(frame(BINARY, bytes(size)))
        for _ in range(10):
            await asyncio.sleep(0)
        assert service.memory.taken == COPIES * size
        async with service.connection() as (other, refused):
            other.data_received(frame(BINARY, bytes(60_000))[:-1])
            await refused.is_told_to_close(1013, b"overloaded: ")
        service.session.may_answer.set()
        await client.hears(b"%d bytes" % size)
        await until(lambda: not service.memory.taken)
        async with service.connection() as (other, answered):
            other.data_received(frame(BINARY, bytes(60_000)))
            await answered.hears(b"60000 bytes")
    assert service.memory.taken == 0


@pytest.mark.fault("I19")
@pytest.mark.parametrize(
    "sent",
    [frame(TEXT, b"\xff"), frame(TEXT, b"\xe2", is_last=False) + frame(FRAGMENT, b"\x82")],
    ids=["one frame", "fragments"],
)
async def test_a_text_in_no_utf8_ends_its_connection_without_a_traceback(
    sent: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "freerein"):
        async with Service(LIMITS).connection() as (protocol, client):
            protocol.data_received(sent * 3)
            await client.is_told_to_close(
                1007, b"malformed_request: Send binary messages. A text must be UTF-8; it is not."
            )
    (line,) = caplog.records
    assert (line.message, vars(line)["code"], line.exc_info) == ("call", "malformed_request", None)


@pytest.mark.fault("C24")
@pytest.mark.parametrize(
    ("sent", "code"),
    [
        (frame(BINARY, b"x" * 100)[:50], "deadline_exceeded"),
        (frame(BINARY, bytes(90_000)) + frame(BINARY, bytes(90_000))[:-1], "overloaded"),
        (frame(PONG) * 3000, "overloaded"),
        (frame(BINARY, is_last=False) + frame(FRAGMENT, is_last=False) * 1100, "too_large"),
        (frame(BINARY, bytes(9 * 2**20))[:100], "too_large"),
        (b"\xff\xff", "malformed_request"),
    ],
    ids=["late", "much", "flood", "fragments", "large", "no frame"],
)
async def test_the_log_says_which_rule_a_client_broke(sent: bytes, code: str, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "freerein"):
        async with Service(QUICK).connection() as (protocol, client):
            protocol.data_received(sent)
            await asyncio.wait_for(client.closed.wait(), 60)
    assert [(line.message, vars(line)["code"]) for line in caplog.records] == [("call", code)]


@pytest.mark.fault("I21")
@pytest.mark.parametrize("sent", [frame(BINARY, b"x"), frame(PONG), frame(PING)], ids=["message", "pong", "ping"])
async def test_whatever_arrives_is_a_sign_of_life(sent: bytes) -> None:
    limits = replace(LIMITS, ping_s=0.2)
    async with Service(limits).connection() as (protocol, client):
        for _ in range(5):
            client.heard = b""
            await client.hears(bytes([0x80 | PING]))
            assert protocol.pong_timer is not None
            protocol.data_received(sent)
            assert protocol.pong_timer is None
        assert not client.closed.is_set()
        await asyncio.wait_for(client.closed.wait(), 60)  # nothing arrives any more


@pytest.mark.fault("I21")
async def test_a_reply_that_is_never_read_ends_its_connection() -> None:
    limits = replace(LIMITS, write_s=0.1, ping_s=600.0)
    async with Service(limits).connection() as (protocol, client):
        protocol.pause_writing()
        protocol.data_received(frame(BINARY, b"x"))
        await asyncio.wait_for(client.aborted.wait(), 60)


@pytest.mark.fault("I20")
@pytest.mark.parametrize("path", [b"/ws", b"/policy/act?goal.text=go", b"//", b"/healthz"])
async def test_another_path_is_refused_with_the_right_one(path: bytes) -> None:
    async with Service(LIMITS).connection(path, accepted=False) as (_, client):
        await client.hears(b"The WebSocket of this service is at `/`")
    assert client.heard.startswith(b"HTTP/1.1 404 ")
    assert b"application/problem+json" in client.heard
