"""What a service can at best come near: bare servers, `python -m benchmarks.floors KIND ARGUMENT`.

    websocket BYTES   answers a msgpack map with an image by a map with so many bytes, as servers of policies often do
    stream BYTES      answers a message on a gRPC stream by so many bytes
    policy FOLDER     answers a frame on a gRPC stream by the policy's action, one call of the model for each
    threaded FOLDER   the same, with the model's calls on a thread, so that the event loop answers others meanwhile

They check nothing, count nothing and log nothing. They run on the event loop that services run on.
"""

import argparse
import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import grpc
import msgpack  # type: ignore[import-untyped]
import numpy as np
import torch
import uvloop
from websockets.asyncio.server import ServerConnection, serve

from benchmarks.processes import until_input_ends
from freerein_imitation.model import GoalConditionedPolicy, goal_conditioned_policy
from freerein_imitation.model.step import Step

STREAM = "/floor.Floor/Stream"
SEQ_BYTES = 8
"""What a message to `policy`, and its answer, begin with: its number on its stream, little-endian."""

_LOOPBACK = "127.0.0.1"
_GRACE_S = 1.0
Call: TypeAlias = "grpc.aio.StreamStreamCall[bytes, bytes]"
_Stream = Callable[[AsyncIterator[bytes], "grpc.aio.ServicerContext[Any, Any]"], Awaitable[None]]


def main() -> None:
    """Serves until the input ends."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.floors", description="Serves the least there is.")
    parser.add_argument("kind", choices=_KINDS)
    parser.add_argument("argument")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    uvloop.run(_KINDS[arguments.kind](arguments.argument))


async def _websocket(reply_bytes: str) -> None:
    reply = bytes(int(reply_bytes))

    async def answer(connection: ServerConnection) -> None:
        async for message in connection:
            len(msgpack.unpackb(message)["image"])
            await connection.send(msgpack.packb({"actions": reply}))

    async with serve(answer, _LOOPBACK, 0, compression=None, max_size=None) as server:
        await until_input_ends(next(iter(server.sockets)).getsockname()[1])


async def _stream(reply_bytes: str) -> None:
    await _serve_grpc(partial(_echo, bytes(int(reply_bytes))))


async def _policy(folder: str) -> None:
    policy = goal_conditioned_policy.load(Path(folder), "cpu")

    async def step(*arguments: Any) -> Step:
        return policy.step(*arguments)

    await _serve_grpc(partial(_act, policy, step))


async def _threaded(folder: str) -> None:
    policy = goal_conditioned_policy.load(Path(folder), "cpu")
    with ThreadPoolExecutor(1) as thread:

        async def step(*arguments: Any) -> Step:
            return await asyncio.get_running_loop().run_in_executor(thread, policy.step, *arguments)

        await _serve_grpc(partial(_act, policy, step))


async def _serve_grpc(answer: _Stream) -> None:
    service, method = STREAM.strip("/").split("/")
    handler = grpc.method_handlers_generic_handler(service, {method: grpc.stream_stream_rpc_method_handler(answer)})
    server = grpc.aio.server()
    server.add_generic_rpc_handlers((handler,))
    port = server.add_insecure_port(f"{_LOOPBACK}:0")
    await server.start()
    await until_input_ends(port)
    await server.stop(_GRACE_S)


async def _echo(reply: bytes, messages: AsyncIterator[bytes], context: "grpc.aio.ServicerContext[Any, Any]") -> None:
    async for _ in messages:
        await context.write(reply)


async def _act(
    policy: GoalConditionedPolicy,
    take: Callable[..., Awaitable[Step]],
    messages: AsyncIterator[bytes],
    context: "grpc.aio.ServicerContext[Any, Any]",
) -> None:
    """Answers each message by its number and an action; the first message is the goal."""
    shape = (1, policy.height, policy.width, policy.channels)
    goal = policy.encode_goals(np.frombuffer(await anext(messages), np.uint8).reshape(shape))
    previous, memory = np.zeros((1, policy.action_size), np.float32), np.zeros((1, policy.memory_size), np.float32)
    async for message in messages:
        frames = np.frombuffer(message, np.uint8, offset=SEQ_BYTES).reshape(shape)
        step = await take(frames, goal, previous, memory)
        memory = step.memory
        await context.write(message[:SEQ_BYTES] + step.actions.tobytes() + memory.tobytes())


_KINDS = {"websocket": _websocket, "stream": _stream, "policy": _policy, "threaded": _threaded}


if __name__ == "__main__":
    main()
