"""The limits that a request meets before its route: headers, and the memory for all bodies together."""

import asyncio

import httpx
import pytest
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.rest.middleware import RequestMiddleware

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
def client(reader: Reader) -> httpx.AsyncClient:
    limits = Limits(buffered_bytes=BUDGET)
    app = RequestMiddleware(reader, metrics=Metrics(), limits=limits, token="", paths=set())
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
