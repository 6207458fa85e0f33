"""Robots for the tests of control streams: what they say, how they say it, and what they must hear."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from dataclasses import replace
from typing import Any

import numpy as np

from freerein.serving.batcher import BatchResult
from freerein.types.common import ActionSpec, Camera, Goal, Image, ModelRef, Observation
from freerein.types.imitation import ActRequest, ControlRequest, ControlResponse, Hello, Observed
from freerein_imitation.core import PolicyRunner
from freerein_imitation.core.act_context import ActContext
from freerein_imitation.core.inference import InferenceResult
from freerein_imitation.core.policy_session import PolicySession

FAULTS = ("right", "raises", "nan", "shape", "infinite", "held")
ACTION = ActionSpec(2, 0, ("x", "y"), "m", (0.01, 0.01))
CAMERAS = (Camera("front", 4, 4, 3),)


def picture(brightness: int, *, fault: str = "right", hundredths: int = 0) -> Image:
    """Returns an image that asks the policy for a fault, or to take hundredths of a second."""
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[0, 0] = FAULTS.index(fault), hundredths, brightness
    return Image("raw_rgb8", 4, 4, pixels.tobytes(), "front")


def goal(*brightness: int) -> Goal:
    return Goal(tuple(picture(each) for each in brightness))


def hello(*brightness: int, **changes: Any) -> ControlRequest:
    """Returns the Hello of a robot that pursues pictures of these brightnesses."""
    said = Hello(goal(*brightness or (255,)), CAMERAS, ACTION, 0.02, valid_for_s=30.0)
    return ControlRequest(hello=replace(said, **changes))


def seen(seq: int, brightness: int = 0, *, did: Any = None, **asked: Any) -> ControlRequest:
    """Returns an observation, and the one action that was executed before it."""
    executed = None if did is None else np.array(did, np.float32)[None]
    observation = Observation((picture(brightness, **asked),))
    return ControlRequest(observed=Observed(seq, observation, executed, observation_time_ns=seq))


def asked(brightness: int, *goals: int, did: Any = None, state: bytes = b"", **changes: Any) -> ActRequest:
    """Returns an `Act` that says the same."""
    executed = None if did is None else np.array(did, np.float32)[None]
    request = ActRequest(Observation((picture(brightness),)), goal(*goals), executed, state)
    return replace(request, **changes)


async def turns(count: int = 50) -> None:
    """Lets everything that runs in this process go on, so that what was said is taken."""
    for _ in range(count):
        await asyncio.sleep(0)


class Stream:
    """One control stream, spoken to by hand.

    Args:
        control: A client's method, or a core's.
    """

    def __init__(self, control: Callable[[AsyncIterator[Any]], Any]) -> None:
        self._said: asyncio.Queue[Any] = asyncio.Queue()
        self._heard: AsyncGenerator[ControlResponse, None] = control(self._requests())

    def say(self, *requests: Any) -> None:
        for request in requests:
            self._said.put_nowait(request)

    async def hear(self) -> ControlResponse:
        return await asyncio.wait_for(anext(self._heard), 60)

    async def ask(self, request: Any) -> ControlResponse:
        self.say(request)
        return await self.hear()

    async def rest(self) -> list[ControlResponse]:
        """Says no more, and returns all that is still answered."""
        self._said.put_nowait(None)
        return [reply async for reply in self._heard]

    async def leave(self) -> None:
        await self._heard.aclose()

    async def _requests(self) -> AsyncIterator[Any]:
        while (request := await self._said.get()) is not None:
            yield request


class Oracle:
    """What one robot must hear, were it alone: each answer from the whole history, in batches of one."""

    def __init__(self, context: ActContext) -> None:
        self._runner = PolicyRunner()
        self._session = PolicySession(context)

    @classmethod
    async def of(cls, policy: Any, *brightness: int) -> "Oracle":
        return cls(await ActContext.create(ModelRef("oracle", "0" * 12), policy, goal(*brightness), max_steps=0))

    async def answer(self, request: ControlRequest) -> InferenceResult:
        observed = request.observed
        assert observed is not None
        item = await self._session.parse(observed.observation, observed.executed_actions, elapsed=1)
        (result,) = self._runner.run_batch([item])
        assert isinstance(result, InferenceResult)
        self._session.answer(BatchResult(result, 0, 0, 1), arrived_ns=0)
        return result

    async def check(self, request: ControlRequest, reply: ControlResponse) -> None:
        """Fails unless a chunk is what this robot must hear."""
        expected = await self.answer(request)
        assert reply.chunk is not None, reply
        assert request.observed is not None
        assert reply.seq == request.observed.seq
        np.testing.assert_allclose(reply.chunk.actions, expected.actions, rtol=0, atol=1e-5)
        assert reply.chunk.goal_index == expected.state.goal_index
        assert reply.chunk.goal_reached == expected.reached
        assert (reply.chunk.done, reply.chunk.done_by) == (expected.done, expected.done_by)
        assert reply.chunk.in_distribution == expected.in_distribution
