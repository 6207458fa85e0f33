"""Bare servers and clients, a lower bound for services: `python -m benchmarks.bare_transport KIND ARGUMENT`.

    websocket BYTES   answers a msgpack map with an image by a map with that many bytes, as policy servers often do
    stream BYTES      answers each message of a gRPC stream by that many bytes
    policy FOLDER     answers each frame of a gRPC stream by the policy's action, one model call per frame
    threaded FOLDER   the same with the model calls on a thread, so that the event loop can serve others meanwhile

Servers check, count and log nothing, and run on the same event loop as services. Clients send prepared messages and do
not decode replies.
"""

import argparse
import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import grpc
import msgpack  # type: ignore[import-untyped]
import numpy as np
import torch
import uvloop
from websockets.asyncio.client import connect
from websockets.asyncio.server import ServerConnection, serve

from benchmarks.servers import serve_until_stdin_closes
from benchmarks.timing import Call
from freerein_imitation.methods import METHODS
from freerein_imitation.model.policy import Policy, PolicyOutput

STREAM = "/bare.Bare/Stream"
SEQ_BYTES = 8
"""Bytes of the sequence number, little-endian, that begins a message to `policy` and its reply."""

_LOOPBACK = "127.0.0.1"
_GRACE_S = 1.0
_Context = grpc.aio.ServicerContext[Any, Any]


def main() -> None:
    """Serves until stdin closes."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bare_transport", description="A server and no more.")
    parser.add_argument("kind", choices=_SERVERS)
    parser.add_argument("argument")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
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

    async def echo(messages: AsyncIterator[bytes], context: _Context) -> None:
        async for _ in messages:
            await context.write(reply)

    await _serve_grpc(echo)


async def _serve_policy(folder: str) -> None:
    policy = METHODS.load(Path(folder), "cpu")

    async def step(*arguments: Any) -> PolicyOutput:
        return policy.step(*arguments)

    await _serve_grpc(partial(_act, policy, step))


async def _serve_policy_on_thread(folder: str) -> None:
    policy = METHODS.load(Path(folder), "cpu")
    with ThreadPoolExecutor(1) as thread:

        async def step(*arguments: Any) -> PolicyOutput:
            return await asyncio.get_running_loop().run_in_executor(thread, policy.step, *arguments)

        await _serve_grpc(partial(_act, policy, step))


async def _serve_grpc(answer: Callable[[AsyncIterator[bytes], _Context], Awaitable[None]]) -> None:
    service, method = STREAM.strip("/").split("/")
    handler = grpc.method_handlers_generic_handler(service, {method: grpc.stream_stream_rpc_method_handler(answer)})
    server = grpc.aio.server()
    server.add_generic_rpc_handlers((handler,))
    port = server.add_insecure_port(f"{_LOOPBACK}:0")
    await server.start()
    await serve_until_stdin_closes(port)
    await server.stop(_GRACE_S)


async def _act(
    policy: Policy,
    step: Callable[..., Awaitable[PolicyOutput]],
    messages: AsyncIterator[bytes],
    context: _Context,
) -> None:
    """Answers each message by its number, an action and the memory; the first message is the goal."""
    (camera,) = policy.spec.cameras
    shape = (1, camera.height, camera.width, camera.channels)
    goal = policy.encode_goals({camera.name: np.frombuffer(await anext(messages), np.uint8).reshape(shape)})
    previous, recurrent = policy.spec.action.no_action()[None], np.zeros((1, policy.spec.recurrent_size), np.float32)
    async for message in messages:
        frames = {camera.name: np.frombuffer(message, np.uint8, offset=SEQ_BYTES).reshape(shape)}
        answer = await step(frames, goal, previous, recurrent)
        recurrent = answer.recurrent
        await context.write(message[:SEQ_BYTES] + answer.actions.tobytes() + recurrent.tobytes())


_SERVERS = {
    "websocket": _serve_websocket,
    "stream": _serve_stream,
    "policy": _serve_policy,
    "threaded": _serve_policy_on_thread,
}


if __name__ == "__main__":
    main()
