"""What a request meets around its route: limits of headers and of memory for all bodies, metrics and a log line."""

import asyncio
import logging
import time

import httpx
import pytest
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from freerein.serving.call_recorder import OTHER, CallRecorder
from freerein.serving.limits import Limits
from freerein.serving.memory import Memory
from freerein.serving.metrics import Metrics
from freerein.serving.rest.middleware import RequestMiddleware
from freerein.serving.rest.origin_policy import OriginPolicy

BUDGET = 300  # of which each byte of a body takes three


class Reader:
    """An app that reads a body, and answers when told to."""

    def __init__(self) -> None:
        self.reading = asyncio.Semaphore(0)
        self.answer = asyncio.Event()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await Request(scope, receive).body()
        self.reading.release()
        await self.answer.wait()
        await Response()(scope, receive, send)


@pytest.fixture
def reader() -> Reader:
    return Reader()


@pytest.fixture
def metrics() -> Metrics:
    return Metrics()


@pytest.fixture
def client(reader: Reader, metrics: Metrics) -> httpx.AsyncClient:
    limits = Limits(buffered_bytes=BUDGET)
    recorders = {"/": CallRecorder(metrics, "rest", "Read")}
    other = CallRecorder(metrics, "rest", OTHER)
    app = RequestMiddleware(
        reader,
        limits=limits,
        memory=Memory(limits),
        token="",
        origin_policy=OriginPolicy(),
        recorders=recorders,
        other=other,
    )
    return httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://x")


async def test_as_many_headers_as_allowed_and_no_more(client: httpx.AsyncClient, reader: Reader) -> None:
    reader.answer.set()
    own = len(client.build_request("GET", "/").headers)
    async with client:
        for count, status in ((100, 200), (101, 400)):
            reply = await client.get("/", headers={f"x-{i}": "1" for i in range(count - own)})
            assert len(reply.request.headers) == count
            assert reply.status_code == status


async def test_as_many_bytes_of_headers_and_path_as_allowed_and_no_more(
    client: httpx.AsyncClient, reader: Reader
) -> None:
    reader.answer.set()
    headers = client.build_request("GET", "/", headers={"x-long": ""}).headers
    own = len("/") + sum(len(key) + len(value) for key, value in headers.raw)
    async with client:
        for size, status in ((16 * 1024, 200), (16 * 1024 + 1, 400)):
            assert (await client.get("/", headers={"x-long": "x" * (size - own)})).status_code == status


@pytest.mark.parametrize("length", ["", "ten", "-1", "+2", "1e3", "0x10", "\xb2"])
async def test_a_length_that_is_no_number_is_malformed(client: httpx.AsyncClient, length: str) -> None:
    async with client:
        reply = await client.post("/", headers={"content-length": length.encode("latin-1")})
    assert (reply.status_code, reply.json()["code"]) == (400, "malformed_request")


@pytest.mark.parametrize(("size", "level", "code"), [(1, "DEBUG", "ok"), (101, "INFO", "overloaded")])
async def test_a_request_is_counted_timed_and_logged(
    client: httpx.AsyncClient,
    reader: Reader,
    metrics: Metrics,
    caplog: pytest.LogCaptureFixture,
    size: int,
    level: str,
    code: str,
) -> None:
    reader.answer.set()
    begun = time.perf_counter()
    with caplog.at_level(logging.DEBUG, "freerein"):
        async with client:
            await client.post("/", content=bytes(size))
    most_s, labels = time.perf_counter() - begun, {"protocol": "rest", "method": "Read"}
    value = metrics.registry.get_sample_value
    assert value("freerein_calls_total", {**labels, "code": code}) == 1
    assert value("freerein_call_seconds_count", labels) == 1
    assert 0 < (value("freerein_call_seconds_sum", labels) or 0) < most_s
    (line,) = (vars(record) for record in caplog.records if record.message == "call")
    assert (line["levelname"], line["code"]) == (level, code)
    assert labels.items() <= line.items()
    assert 0 < line["ms"] < most_s * 1e3


async def test_a_request_is_in_flight_until_its_reply(
    client: httpx.AsyncClient, reader: Reader, metrics: Metrics
) -> None:
    async with client, asyncio.TaskGroup() as tasks:
        request = tasks.create_task(client.get("/"))
        await reader.reading.acquire()
        assert metrics.registry.get_sample_value("freerein_calls_in_flight", {"protocol": "rest"}) == 1
        reader.answer.set()
        await request
        assert metrics.registry.get_sample_value("freerein_calls_in_flight", {"protocol": "rest"}) == 0


@pytest.mark.fault("F6")
async def test_bodies_share_one_budget_and_return_their_part_with_the_reply(
    client: httpx.AsyncClient, reader: Reader
) -> None:
    async with client, asyncio.TaskGroup() as tasks:
        held = tasks.create_task(client.post("/", content=bytes(60)))
        await reader.reading.acquire()
        refused = await client.post("/", content=bytes(41))
        assert (refused.status_code, refused.json()["code"]) == (429, "overloaded")
        allowed = tasks.create_task(client.post("/", content=bytes(40)))
        await reader.reading.acquire()
        reader.answer.set()
        assert [(await each).status_code for each in (held, allowed)] == [200, 200]
        assert (await client.post("/", content=bytes(101))).status_code == 429
        assert (await client.post("/", content=bytes(100))).status_code == 200
