"""A bare server of a policy, a lower bound for `Control`: `python -m benchmarks.bare_policy FOLDER`.

It answers each frame of a gRPC stream by the policy's action, one model call per frame, on its event loop, and checks,
counts and logs nothing. Clients send prepared messages and do not decode replies.
"""

import sys
from collections.abc import AsyncGenerator, AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import torch
import uvloop

from benchmarks.servers import serve_until_stdin_closes
from benchmarks.timing import Call
from freerein_imitation.methods import METHODS
from freerein_imitation.model.policy import Policy

STREAM = "/bare.Bare/Stream"

SEQ_BYTES = 8
"""Bytes of the sequence number, little-endian, that begins a message and its reply."""

_GRACE_S = 1.0


@asynccontextmanager
async def grpc_stream(
    address: str, method: str, messages: Iterator[bytes], *, first: bytes, first_is_answered: bool = False
) -> AsyncGenerator[Call, None]:
    """Opens a bidirectional gRPC stream; yields a function that sends the next message and awaits its reply.

    `first` is sent before the messages; `first_is_answered` says whether the server replies to it.
    """
    async with grpc.aio.insecure_channel(address) as channel:
        stream: grpc.aio.StreamStreamCall[bytes, bytes] = channel.stream_stream(method)()
        await stream.write(first)
        if first_is_answered:
            await stream.read()

        async def call() -> object:
            await stream.write(next(messages))
            return await stream.read()

        yield call
        await stream.done_writing()
        await stream.read()


async def _serve(folder: Path) -> None:
    """Serves until stdin closes."""
    policy = METHODS.load(folder, "cpu")

    async def answer(messages: AsyncIterator[bytes], context: grpc.aio.ServicerContext[Any, Any]) -> None:
        async for reply in _act(policy, messages):
            await context.write(reply)

    service, method = STREAM.strip("/").split("/")
    handler = grpc.method_handlers_generic_handler(service, {method: grpc.stream_stream_rpc_method_handler(answer)})
    server = grpc.aio.server()
    server.add_generic_rpc_handlers((handler,))
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    await serve_until_stdin_closes(port)
    await server.stop(_GRACE_S)


async def _act(policy: Policy, messages: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """Yields each message's number, an action and the memory; the first message is the goal."""
    (camera,) = policy.spec.cameras
    shape = (1, camera.height, camera.width, camera.channels)
    goal = policy.encode_goals({camera.name: np.frombuffer(await anext(messages), np.uint8).reshape(shape)})
    previous, recurrent = policy.spec.action.no_action()[None], np.zeros((1, policy.spec.recurrent_size), np.float32)
    async for message in messages:
        frames = {camera.name: np.frombuffer(message, np.uint8, offset=SEQ_BYTES).reshape(shape)}
        answer = policy.step(frames, goal, previous, recurrent)
        recurrent = answer.recurrent
        yield message[:SEQ_BYTES] + answer.actions.tobytes() + recurrent.tobytes()


if __name__ == "__main__":
    torch.set_num_threads(1)
    uvloop.run(_serve(Path(sys.argv[1])))
