"""Sequences of calls that belong together: sessions of the sim service, control streams, watched runs."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Sequence
from contextlib import aclosing
from functools import partial

import numpy as np

from freerein.types.imitation import ControlRequest, ControlResponse, Hello, Observed
from freerein.types.orchestrator import WatchRunRequest
from freerein.types.sim import CloseSessionRequest, CreateSessionRequest, ResetRequest, StepRequest
from soak.questions import Answer, Question, Services, WrongAnswer

_OF_EACH_KIND = 8
_LEASE_S = 5.0


def all_sequences() -> list[Question]:
    """Returns the sequences; each is answered by what all its calls are answered."""
    return [partial(kind, seed=seed) for kind in (session, control) for seed in range(_OF_EACH_KIND)] + [watch]


async def open_session(services: Services, seed: int) -> str:
    """Returns a session of the sim service that ends by itself, 5 s after its last call."""
    request = CreateSessionRequest("grid", num_envs=2, seed=seed, lease_s=_LEASE_S)
    return (await services.sim.create_session(request)).session


async def session(services: Services, timeout_s: float, seed: int) -> Answer:
    """Steps two environments; returns the frames."""
    rng = np.random.default_rng(seed)
    session_id = await open_session(services, seed)
    frames = [(await services.sim.reset(ResetRequest(session_id, cameras=("top",)), timeout_s=timeout_s)).frames["top"]]
    for step_id in range(1, 5 + seed):
        step = StepRequest(session_id, step_id, rng.integers(0, 4, (2, 1)), ("top",))
        frames.append((await services.sim.step(step, timeout_s=timeout_s)).frames["top"])
    await services.sim.close_session(CloseSessionRequest(session_id))
    return np.concatenate([each.ravel() for each in frames])


async def control(services: Services, timeout_s: float, seed: int) -> Answer:
    """Sends observations on a control stream, each after the answer to the one before; returns the actions."""
    messages = [hello(services, seed), *(observed(services, seed, seq) for seq in range(4 + seed))]
    _, *replies = await converse(services, messages, timeout_s=timeout_s)
    for reply in replies:
        if reply.chunk is None:
            raise WrongAnswer(f"An observation was not answered by a chunk: {reply.error or reply}")
    return np.concatenate([reply.chunk.actions.ravel() for reply in replies if reply.chunk])


async def watch(services: Services, timeout_s: float) -> Answer:
    """Watches a run that has ended; returns the numbers of its events."""
    events = services.orchestrator.watch_run(WatchRunRequest(services.run_id), timeout_s=timeout_s)
    return np.array([event.sequence async for event in events])


def hello(services: Services, seed: int) -> ControlRequest:
    """Returns the Hello of a robot like the model's."""
    spec = services.spec
    return ControlRequest(
        hello=Hello(services.act_request(seed).goal, spec.cameras, spec.action, spec.control_dt_s, valid_for_s=60)
    )


def observed(services: Services, seed: int, seq: int) -> ControlRequest:
    """Returns an observation."""
    return ControlRequest(observed=Observed(seq, services.act_request(100 * seed + seq).observation))


async def converse(
    services: Services, messages: Sequence[ControlRequest], *, heard: int = 1_000, timeout_s: float = 30.0
) -> list[ControlResponse]:
    """Sends messages on a control stream, each after the reply to the one before; leaves after some replies.

    Returns:
        The replies.
    """
    left, to_send, replies = iter(messages), asyncio.Queue[ControlRequest | None](), list[ControlResponse]()

    async def requests() -> AsyncIterator[ControlRequest]:
        while (message := await to_send.get()) is not None:
            yield message

    to_send.put_nowait(next(left))
    stream: AsyncGenerator[ControlResponse, None] = services.imitation.control(requests(), timeout_s=timeout_s)
    try:
        async with aclosing(stream):
            async for reply in stream:
                replies.append(reply)
                to_send.put_nowait(next(left, None))
                if len(replies) >= heard:
                    break
    finally:
        to_send.put_nowait(None)
    return replies
