"""Clients that send or read too slowly: their connections are closed, and nobody else waits for them."""

import asyncio
import contextlib
import gc
import json
import select
import selectors
import socket
import ssl
import time
import weakref
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import psutil
import pytest
from starlette.types import Receive, Scope, Send

from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.rest.http_server import HttpServer, make_server

pytestmark = pytest.mark.e2e
RECEIPT_S, WRITE_S = 2.0, 3.0
HEAD = b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n"
WHOLE = HEAD + b"\r\n"
CHUNKED = (
    b"POST /v1/segment HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n"
    b"transfer-encoding: chunked\r\n\r\n"
)
POST = b"POST /v1/segment HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: 1000\r\n\r\n"


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty(FREEREIN_RECEIPT_S=str(RECEIPT_S), FREEREIN_WRITE_S=str(WRITE_S))


def trickle(connection: socket.socket, data: bytes, every_s: float) -> None:
    """Sends bytes one by one until the other side closes."""
    connection.settimeout(every_s)
    with contextlib.suppress(ConnectionResetError, BrokenPipeError):
        for byte in data:
            connection.sendall(bytes([byte]))
            with contextlib.suppress(TimeoutError):
                if not connection.recv(4096):
                    break
        else:
            pytest.fail("the connection was never closed")


TRICKLES = {  # what is sent at once, and then byte by byte
    "header": (b"", HEAD + b"x" * 1000),
    "body": (POST, b"x" * 1000),
    "header of a second request": (WHOLE, HEAD + b"x" * 1000),
    "body of a second request": (WHOLE + POST, b"x" * 1000),
    "header that came with the first request": (WHOLE + HEAD, b"x" * 1000),
}


@pytest.mark.fault("C7")
def test_a_request_that_trickles_in_is_cut_off(faulty: Any, least_of_many: Any) -> None:
    def seconds(name: str) -> float:
        first, slowly = TRICKLES[name]
        begun = time.monotonic()
        with faulty.connect() as connection:
            connection.sendall(first)
            if first.startswith(WHOLE):
                connection.recv(4096)
            trickle(connection, slowly, 0.1)
        return time.monotonic() - begun

    def longest() -> float:
        with ThreadPoolExecutor(len(TRICKLES)) as pool:
            found = list(pool.map(seconds, TRICKLES))
        assert min(found) > RECEIPT_S - 0.2
        return max(found)

    assert least_of_many(longest, below=RECEIPT_S + 1.0) < RECEIPT_S + 1.0


@pytest.mark.fault("C7")
def test_a_client_that_falls_silent_is_cut_off(faulty: Any, least_of_many: Any) -> None:
    def seconds() -> float:
        begun = time.monotonic()
        with contextlib.ExitStack() as stack:
            for sent in (b"", HEAD, POST, POST + b"{", WHOLE + POST):
                connection = stack.enter_context(faulty.connect())
                connection.sendall(sent)
                stack.callback(read_to_the_end, connection)
        return time.monotonic() - begun

    assert least_of_many(seconds, below=RECEIPT_S + 1.0) < RECEIPT_S + 1.0


LATE = {
    "header": HEAD,
    "header of a second request": WHOLE + HEAD,
    "no body": POST,
    "part of a body": POST + b"{",
    "part of a body in chunks": CHUNKED + b"2\r\n{ \r\n",
    "part of a form": POST.replace(b"application/json", b"multipart/form-data; boundary=x") + b"--x\r\n",
}


@pytest.mark.fault("C7")
def test_a_request_that_is_late_is_told_so_and_how_to_mend_it(faulty: Any) -> None:
    counted = 'freerein_calls_total{code="request_timeout",method="Segment",protocol="rest"}'
    before = faulty.metric(counted)
    with contextlib.ExitStack() as stack:
        connections = [stack.enter_context(faulty.connect()) for _ in LATE]
        for connection, sent in zip(connections, LATE.values(), strict=True):
            connection.sendall(sent)
        replies = [exchange(connection) for connection in connections]
    for reply in replies:
        head, _, body = reply[reply.rindex(b"HTTP/1.1 ") :].partition(b"\r\n\r\n")
        problem = json.loads(body)
        assert head.startswith(b"HTTP/1.1 408 ")
        assert (problem["status"], problem["code"]) == (408, "request_timeout")
        assert "within 2 s" in problem["detail"]
        assert "FREEREIN_RECEIPT_S" in problem["hint"]
        assert f"x-request-id: {problem['request_id']}".encode() in head
        assert b"connection: close" in head
    assert faulty.metric(counted) - before == 4


def exchange(connection: socket.socket) -> bytes:
    received = b""
    while part := connection.recv(65536):
        received += part
    return received


@pytest.mark.fault("C7")
def test_a_client_that_is_late_and_still_sends_reads_the_answer(faulty: Any) -> None:
    with faulty.connect() as connection:
        connection.sendall(POST.replace(b": 1000", b": 10000000"))
        with contextlib.suppress(ConnectionError):
            while not select.select([connection], [], [], 0.01)[0]:
                connection.sendall(b" " * 1000)
        assert connection.recv(65536).startswith(b"HTTP/1.1 408 ")


def read_to_the_end(connection: socket.socket) -> None:
    with contextlib.suppress(ConnectionResetError):
        while connection.recv(4096):
            pass


@pytest.mark.fault("F10")
def test_a_tls_client_that_falls_silent_is_cut_off(
    start_faulty: Callable[..., Any], certificate: tuple[Path, Path], least_of_many: Any
) -> None:
    key, chain = map(str, certificate)
    faulty = start_faulty(FREEREIN_RECEIPT_S=str(RECEIPT_S), FREEREIN_TLS_KEY=key, FREEREIN_TLS_CERT=chain)
    trusting = ssl.create_default_context(cafile=chain)

    def seconds() -> float:
        begun = time.monotonic()
        with faulty.connect() as silent, faulty.connect() as halfway, faulty.connect() as shaken:
            halfway.sendall(b"\x16\x03\x01")
            with trusting.wrap_socket(shaken, server_hostname="localhost") as client:
                for connection in (silent, halfway, client):
                    read_to_the_end(connection)
        assert time.monotonic() - begun > RECEIPT_S - 0.2
        return time.monotonic() - begun

    def seconds_over_grpc() -> float:
        begun, address = time.monotonic(), ("127.0.0.1", faulty.service.grpc_port)
        with socket.create_connection(address, 60) as silent, socket.create_connection(address, 60) as halfway:
            halfway.sendall(b"\x16\x03\x01")
            for connection in (silent, halfway):
                read_to_the_end(connection)
        return time.monotonic() - begun

    assert least_of_many(seconds, below=RECEIPT_S + 1.0) < RECEIPT_S + 1.0
    assert least_of_many(seconds_over_grpc, below=RECEIPT_S + 5.0) < RECEIPT_S + 5.0


@pytest.mark.fault("C7")
def test_a_slow_answer_is_not_a_slow_client(faulty: Any) -> None:
    reply = faulty.segment(4, 5, hundredths=200)
    assert reply.json()["labels"] == [0, 1]


@pytest.mark.fault("C7")
@pytest.mark.fault("G10")
def test_many_slow_clients_slow_nobody_else(faulty: Any, least_of_many: Any, fuzz: bool) -> None:
    def times_slower() -> float:
        alone = latencies(faulty, 200)
        with attack(faulty, 2_000 if fuzz else 300):
            return percentile(latencies(faulty, 200), 0.99) / max(percentile(alone, 0.99), 0.01)

    assert least_of_many(times_slower, below=2.0) < 2.0


@contextlib.contextmanager
def attack(faulty: Any, count: int) -> Iterator[None]:
    """Opens many connections that each send a part of a request, and no more."""
    with contextlib.ExitStack() as stack:
        for i in range(count):
            connection = stack.enter_context(faulty.connect())
            connection.sendall((b"", HEAD, POST)[i % 3])
        yield


def latencies(faulty: Any, count: int) -> list[float]:
    seconds = []
    for _ in range(count):
        begun = time.perf_counter()
        assert faulty.http.get("/healthz").status_code == 200
        seconds.append(time.perf_counter() - begun)
    return sorted(seconds)


def percentile(values: list[float], share: float) -> float:
    return values[int(share * (len(values) - 1))]


@pytest.mark.fault("C8")
def test_a_client_that_does_not_read_is_cut_off_and_fills_no_memory(faulty: Any, least_of_many: Any) -> None:
    before = faulty.process.memory_info().rss

    def seconds() -> float:
        with socket.socket() as connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.connect(("127.0.0.1", faulty.service.http_port))
            connection.setblocking(False)
            begun = time.monotonic()
            full = flood(connection)
            while open_to(faulty, connection.getsockname()[1]):
                with contextlib.suppress(OSError):
                    connection.send(b"G")  # a live client that sends, and still reads nothing
                time.sleep(0.02)
        assert time.monotonic() - begun > WRITE_S - 0.2
        return time.monotonic() - full

    assert least_of_many(seconds, below=WRITE_S + 1.5) < WRITE_S + 1.5
    assert faulty.process.memory_info().rss - before < 16 * 2**20


def flood(connection: socket.socket) -> float:
    """Asks for large replies, reading none, until no more can be sent; returns when that was."""
    question = b"GET /openapi.json HTTP/1.1\r\nhost: localhost\r\n\r\n" * 1000
    selector = selectors.DefaultSelector()
    selector.register(connection, selectors.EVENT_WRITE)
    with selector:
        while selector.select(0.3):
            with contextlib.suppress(BlockingIOError):
                connection.send(question)
    return time.monotonic() - 0.3


def open_to(faulty: Any, port: int) -> bool:
    """Tells whether the service holds a connection to a client's port."""
    return any(
        connection.raddr and connection.raddr.port == port and connection.status == psutil.CONN_ESTABLISHED
        for connection in faulty.process.net_connections("tcp")
    )


def test_a_client_that_reads_slowly_but_reads_gets_all(faulty: Any) -> None:
    with faulty.connect() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.sendall(b"GET /openapi.json HTTP/1.1\r\nhost: localhost\r\n\r\n" * 3)
        received = b""
        while received.count(b"HTTP/1.1 200") < 3:
            received += connection.recv(512)
    assert received.count(b"HTTP/1.1 200") == 3


class Stream:
    """An app that sends a reply of many parts, until so many bytes are sent or the client is gone.

    Attributes:
        sent: Bytes sent so far.
        ended: Set when it sends no more.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self.sent = 0
        self.ended = asyncio.Event()

    def ask_again(self, most: int) -> None:
        """Prepares for another request on the connection."""
        self._most, self.sent = most, 0
        self.ended.clear()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await receive()
        gone = asyncio.create_task(receive())
        await send({"type": "http.response.start", "status": 200, "headers": []})
        while self.sent < self._most and not gone.done():
            await send({"type": "http.response.body", "body": bytes(16 * 1024), "more_body": True})
            self.sent += 16 * 1024
            await asyncio.sleep(0)
        await send({"type": "http.response.body"})
        self.ended.set()
        await gone


@contextlib.asynccontextmanager
async def serving(app: Stream, write_s: float, **bounds: Any) -> AsyncIterator[tuple[HttpServer, socket.socket]]:
    """The HTTP server with an app, and a client that has asked it for its reply."""
    limits = Limits(write_s=write_s, drain_s=1.0, **bounds)
    server = make_server(app, limits=limits, health=Health(), cert=None, key=None)
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.socket() as client:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 65536)  # the kernel shall hold little of a reply
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
        running = asyncio.create_task(server.serve([listener]))
        client.connect(listener.getsockname())
        client.setblocking(False)
        client.send(WHOLE)
        try:
            yield server, client
        finally:
            client.close()
            server.should_exit = True
            await running


async def test_a_client_that_leaves_a_stream_unread_is_cut_off_and_fills_no_memory() -> None:
    app = Stream(64 * 2**20)
    async with serving(app, 0.3), asyncio.timeout(60):
        await app.ended.wait()
    assert app.sent < 16 * 2**20


async def test_a_client_that_reads_a_stream_gets_it_for_longer_than_it_may_pause() -> None:
    async with serving(Stream(2**40), 2.0) as (_, client):
        begun = time.monotonic()
        while time.monotonic() - begun < 4.0:
            assert await asyncio.get_running_loop().sock_recv(client, 65536)
            await asyncio.sleep(0.01)  # the server sends faster than this reads


async def test_a_reply_that_was_read_shortens_no_deadline_of_the_next() -> None:
    app = Stream(0)
    async with serving(app, 0.8) as (_, client), asyncio.timeout(60):
        await asyncio.get_running_loop().sock_recv(client, 65536)
        await asyncio.sleep(0.6)  # a deadline that began with the first reply would end soon
        app.ask_again(2**40)
        client.send(WHOLE)
        begun = time.monotonic()
        await app.ended.wait()
        assert time.monotonic() - begun > 0.7


async def test_a_connection_may_be_idle_for_as_long_as_load_balancers_keep_theirs() -> None:
    begun = asyncio.get_running_loop().time()
    async with serving(Stream(0), 600.0) as (server, client), asyncio.timeout(60):
        await asyncio.get_running_loop().sock_recv(client, 65536)
        (connection,) = server.server_state.connections
        timer = connection.timeout_keep_alive_task
        assert timer is not None
        assert timer.when() - begun >= 75


async def test_idle_connections_are_bounded_and_the_longest_idle_is_closed() -> None:
    app, loop = Stream(0), asyncio.get_running_loop()
    async with serving(app, 600.0, idle_connections=2) as (server, first), asyncio.timeout(60):
        with socket.socket() as second, socket.socket() as third:
            await read_reply(first)
            for client in (second, third):
                client.setblocking(False)
                await loop.sock_connect(client, server.servers[0].sockets[0].getsockname())
                client.send(WHOLE)
                await read_reply(client)
            while await loop.sock_recv(first, 65536):
                pass
            for client in (second, third, second):
                client.send(WHOLE)
                assert (await read_reply(client)).startswith(b"HTTP/1.1 200")


async def read_reply(client: socket.socket) -> bytes:
    """Returns a whole reply in chunks."""
    received = b""
    while not received.endswith(b"0\r\n\r\n"):
        received += (part := await asyncio.get_running_loop().sock_recv(client, 65536))
        assert part
    return received


async def test_a_connection_that_is_closed_is_forgotten_at_once() -> None:
    async with serving(Stream(0), 600.0) as (server, client), asyncio.timeout(60):
        await asyncio.get_running_loop().sock_recv(client, 65536)
        (connection,) = map(weakref.ref, server.server_state.connections)
        client.close()
        while connection():
            await asyncio.sleep(0.01)
            gc.collect()
