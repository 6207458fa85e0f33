"""The servers of benchmarks: services as users run them, servers of our own, REST calls."""

import asyncio
import os
import sys
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable
from contextlib import aclosing, asynccontextmanager
from pathlib import Path
from typing import Any, TypeVar

import httpx
import orjson

from freerein.stack import Stack, choose, free_ports, isolated_environ

_START_TIMEOUT_S = 300.0
_STOP_TIMEOUT_S = 60.0
_CALL_TIMEOUT_S = 60.0
T = TypeVar("T")
Sent = TypeVar("Sent")


@asynccontextmanager
async def run_service(service: str, *, data_dir: Path, **environ: str) -> AsyncGenerator[Stack, None]:
    """Runs a service on free ports, ready when the block begins; `environ` adds environment variables."""
    ports, environ = free_ports([service]), {**isolated_environ(os.environ), **environ}
    async with Stack(choose([service]), data_dir=data_dir, environ=environ, ports=ports) as stack:
        await stack.ready(timeout_s=_START_TIMEOUT_S)
        yield stack


@asynccontextmanager
async def run_server(module: str, *arguments: str) -> AsyncGenerator[int, None]:
    """Runs `python -m MODULE ARGUMENTS`, a server that calls `serve_until_stdin_closes`; yields its port."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-m", module, *arguments, stdin=pipe, stdout=pipe)
    if process.stdin is None or process.stdout is None:
        raise TypeError("asyncio must connect the pipes that it was asked for")
    try:
        line = await process.stdout.readline()
        if not line:
            raise RuntimeError(f"`python -m {module} {' '.join(arguments)}` must print its port; it ended before.")
        yield int(line)
    finally:
        process.stdin.close()
        await asyncio.wait_for(process.wait(), _STOP_TIMEOUT_S)


async def serve_until_stdin_closes(port: int) -> None:
    """Prints the port for the parent process; returns when the parent closes the pipe, or ends."""
    sys.stdout.write(f"{port}\n")
    sys.stdout.flush()
    await asyncio.to_thread(sys.stdin.buffer.read)


@asynccontextmanager
async def exchange(
    connect: Callable[[AsyncIterator[Sent]], AsyncGenerator[T, None]],
) -> AsyncGenerator[Callable[[Sent], Awaitable[T]], None]:
    """Opens a bidirectional stream; yields a function that sends a request and returns its reply."""
    requests: asyncio.Queue[Sent] = asyncio.Queue()

    async def sent() -> AsyncIterator[Sent]:
        while True:
            yield await requests.get()

    async with aclosing(connect(sent())) as replies:

        async def ask(request: Sent) -> T:
            requests.put_nowait(request)
            return await anext(replies)

        yield ask


def rest_client(url: str) -> httpx.AsyncClient:
    """Returns an HTTP client of a REST API."""
    return httpx.AsyncClient(base_url=url, timeout=_CALL_TIMEOUT_S, trust_env=False)


def rest_call(
    client: httpx.AsyncClient,
    path: str,
    body: bytes,
    parse: Callable[[Any], T],
    *,
    media_type: str = "application/json",
) -> Callable[[], Awaitable[T]]:
    """Returns a function that posts a prepared body and parses the JSON reply."""

    async def call() -> T:
        response = await client.post(path, content=body, headers={"content-type": media_type})
        response.raise_for_status()
        return parse(orjson.loads(response.content))

    return call
