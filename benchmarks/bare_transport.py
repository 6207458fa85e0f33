"""Bare servers and clients, a lower bound for services: `python -m benchmarks.bare_transport KIND ARGUMENT`.

    websocket BYTES   answers a msgpack map with an image by a map with that many bytes, as policy servers often do
    stream BYTES      answers each message of a gRPC stream by that many bytes

Servers check, count and log nothing, and run on the same event loop as services. Clients send prepared messages and do
not decode replies.
"""

import argparse
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from typing import Any

import grpc
import msgpack
import uvloop
from websockets.asyncio.client import connect
from websockets.asyncio.server import ServerConnection, serve

from benchmarks.servers import serve_until_stdin_closes
from benchmarks.timing import Call

STREAM = "/bare.Bare/Stream"

_LOOPBACK = "127.0.0.1"
_GRACE_S = 1.0
Context = grpc.aio.ServicerContext[Any, Any]


def main() -> None:
    """Serves until stdin closes."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bare_transport", description="A server and no more.")
    parser.add_argument("kind", choices=_SERVERS)
    parser.add_argument("argument")
    arguments = parser.parse_args()
    uvloop.run(_SERVERS[arguments.kind](arguments.argument))


@asynccontextmanager
async def grpc_stream(
    address: str, method: str, messages: Iterator[bytes], *, first: bytes = b"", first_is_answered: bool = False
) -> AsyncGenerator[Call, None]:
    """Opens a bidirectional gRPC stream; yields a function that sends the next message and awaits its reply.

    `first` is sent before the messages, unless empty; `first_is_answered` says whether the server replies to it.
    """
    async with grpc.aio.insecure_channel(address) as channel:
        stream: grpc.aio.StreamStreamCall[bytes, bytes] = channel.stream_stream(method)()
        if first:
            await stream.write(first)
        if first_is_answered:
            await stream.read()

        async def call() -> object:
            await stream.write(next(messages))
            return await stream.read()

        yield call
        await stream.done_writing()
        await stream.read()


@asynccontextmanager
async def websocket(url: str, image: bytes) -> AsyncGenerator[Call, None]:
    """Opens a websocket; yields a function that sends an image and unpacks the reply."""
    async with connect(url, compression=None, max_size=None, proxy=None) as connection:

        async def call() -> object:
            await connection.send(msgpack.packb({"image": image}))
            return msgpack.unpackb(await connection.recv())

        yield call


async def _serve_websocket(reply_bytes: str) -> None:
    reply = bytes(int(reply_bytes))

    async def answer(connection: ServerConnection) -> None:
        async for message in connection:
            len(msgpack.unpackb(message)["image"])
            await connection.send(msgpack.packb({"actions": reply}))

    async with serve(answer, _LOOPBACK, 0, compression=None, max_size=None) as server:
        await serve_until_stdin_closes(next(iter(server.sockets)).getsockname()[1])


async def _serve_stream(reply_bytes: str) -> None:
    reply = bytes(int(reply_bytes))

    async def echo(messages: AsyncIterator[bytes], context: Context) -> None:
        async for _ in messages:
            await context.write(reply)

    await serve_grpc(echo)


async def serve_grpc(answer: Callable[[AsyncIterator[bytes], Context], Awaitable[None]]) -> None:
    """Answers each stream of messages until stdin closes."""
    service, method = STREAM.strip("/").split("/")
    handler = grpc.method_handlers_generic_handler(service, {method: grpc.stream_stream_rpc_method_handler(answer)})
    server = grpc.aio.server()
    server.add_generic_rpc_handlers((handler,))
    port = server.add_insecure_port(f"{_LOOPBACK}:0")
    await server.start()
    await serve_until_stdin_closes(port)
    await server.stop(_GRACE_S)


_SERVERS = {
    "websocket": _serve_websocket,
    "stream": _serve_stream,
}


if __name__ == "__main__":
    main()
