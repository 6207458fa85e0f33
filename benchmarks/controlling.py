"""A robot on a control stream of the imitation service, through the client that users have."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager

from benchmarks.policies import Scene
from freerein.clients import ImitationClient
from freerein.types.imitation import ControlRequest, ControlResponse

CONTROL = "/freerein.api.imitation.v1.ImitationService/Control"


class Robot:
    """Sends an observation when the one before is answered.

    Args:
        client: The client.
        scene: What it shows.
    """

    def __init__(self, client: ImitationClient, scene: Scene) -> None:
        self._scene = scene
        self._seq = 0
        self._requests: asyncio.Queue[ControlRequest] = asyncio.Queue()
        self._replies = client.control(self._sent())

    async def greet(self) -> None:
        """Says Hello."""
        self._requests.put_nowait(self._scene.hello())
        await anext(self._replies)

    async def answer(self) -> ControlResponse:
        """Sends the next observation; returns the answer, which holds a chunk.

        Raises:
            RuntimeError: The observation was refused.
        """
        self._seq += 1
        self._requests.put_nowait(self._scene.observed(self._seq))
        reply = await anext(self._replies)
        if reply.chunk is None:
            raise RuntimeError(f"An observation must be answered by a chunk; got {reply}.")
        return reply

    async def leave(self) -> None:
        """Ends the stream."""
        await self._replies.aclose()

    async def _sent(self) -> AsyncIterator[ControlRequest]:
        while True:
            yield await self._requests.get()


@asynccontextmanager
async def controlling(client: ImitationClient, scene: Scene) -> AsyncGenerator[Robot, None]:
    """Opens a control stream for as long as the block lasts."""
    robot = Robot(client, scene)
    await robot.greet()
    yield robot
    await robot.leave()
