"""Bare clients: what is sent is ready, and what comes back is not read."""

from collections.abc import AsyncGenerator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from typing import TypeAlias

import grpc
import msgpack  # type: ignore[import-untyped]
from websockets.asyncio.client import connect

Exchange: TypeAlias = Callable[[], Awaitable[object]]
"""Sends one message and returns when it is answered."""


@asynccontextmanager
async def grpc_stream(
    address: str, method: str, messages: Iterator[bytes], *, hello: bytes = b"", is_greeted: bool = False
) -> AsyncGenerator[Exchange, None]:
    """Opens a bidirectional gRPC stream for as long as the block lasts.

    Args:
        address: Where the server listens, `host:port`.
        method: What is called.
        messages: Sent one after the other.
        hello: Sent before them; empty for nothing.
        is_greeted: Whether it is answered.
    """
    async with grpc.aio.insecure_channel(address) as channel:
        call: grpc.aio.StreamStreamCall[bytes, bytes] = channel.stream_stream(method)()
        if hello:
            await call.write(hello)
        if is_greeted:
            await call.read()

        async def exchange() -> object:
            await call.write(next(messages))
            return await call.read()

        yield exchange
        await call.done_writing()
        await call.read()


@asynccontextmanager
async def websocket(url: str, image: bytes) -> AsyncGenerator[Exchange, None]:
    """Opens a websocket for as long as the block lasts; an image goes out, and what comes back is made a dict."""
    async with connect(url, compression=None, max_size=None, proxy=None) as connection:

        async def exchange() -> object:
            await connection.send(msgpack.packb({"image": image}))
            return msgpack.unpackb(await connection.recv())

        yield exchange
