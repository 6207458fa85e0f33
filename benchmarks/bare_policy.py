"""Bare servers of a policy, a lower bound for `Control`: `python -m benchmarks.bare_policy KIND FOLDER`.

policy     answers each frame of a gRPC stream by the policy's action, one model call per frame
threaded   the same with the model calls on a thread, so that the event loop can serve others meanwhile
"""

import argparse
import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import uvloop

from benchmarks.bare_transport import Context, serve_grpc
from freerein_imitation.methods import METHODS
from freerein_imitation.model.policy import Policy, PolicyOutput

SEQ_BYTES = 8
"""Bytes of the sequence number, little-endian, that begins a message and its reply."""


def main() -> None:
    """Serves until stdin closes."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bare_policy", description="A policy and no more.")
    parser.add_argument("kind", choices=_SERVERS)
    parser.add_argument("folder")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    uvloop.run(_SERVERS[arguments.kind](arguments.folder))


async def _serve_policy(folder: str) -> None:
    policy = METHODS.load(Path(folder), "cpu")

    async def step(*arguments: Any) -> PolicyOutput:
        return policy.step(*arguments)

    await serve_grpc(partial(_act, policy, step))


async def _serve_policy_on_thread(folder: str) -> None:
    policy = METHODS.load(Path(folder), "cpu")
    with ThreadPoolExecutor(1) as thread:

        async def step(*arguments: Any) -> PolicyOutput:
            return await asyncio.get_running_loop().run_in_executor(thread, policy.step, *arguments)

        await serve_grpc(partial(_act, policy, step))


async def _act(
    policy: Policy,
    step: Callable[..., Awaitable[PolicyOutput]],
    messages: AsyncIterator[bytes],
    context: Context,
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


_SERVERS = {"policy": _serve_policy, "threaded": _serve_policy_on_thread}


if __name__ == "__main__":
    main()
