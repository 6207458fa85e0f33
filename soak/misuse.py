"""What ill-behaved clients do: they die in the middle of a call, have hardly any time, or break the rules."""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from dataclasses import replace
from random import Random
from typing import Any

import httpx
import numpy as np

from freerein.clients import Channel, ImitationClient, SimClient
from freerein.clients.rpc import Client
from freerein.errors import (
    DeadlineExceeded,
    FailedPrecondition,
    InvalidInput,
    NotFound,
    ServiceError,
    SessionNotFound,
    StepOutOfOrder,
    Unavailable,
)
from freerein.types.orchestrator import GetRunRequest
from freerein.types.sim import CloseSessionRequest, ResetRequest, RestoreRequest, StepRequest
from soak import sequences
from soak.crashing import dying_connection, reset_after
from soak.questions import Answer, Question, Services, WrongAnswer, check, segment_json

_NOTHING = "0" * 32
_CALL_S, _LEAVES_AFTER_S = 30.0, 0.03
_TEXTS = (b"", b"{", b'{"frames": NaN}', b'{"frames": {}, "secret": 1}', b"\xff\xfe", b"[" * 5_000)

Misuse = Callable[[Services, Random], Awaitable[None]]


async def crash_over_rest(services: Services, rng: Random) -> None:
    """Dies while its request is on its way, or before the reply has come."""
    body = segment_json(rng.randrange(16))
    head = "POST /v1/segment HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\ncontent-length: "
    request = f"{head}{len(body)}\r\n\r\n".encode() + body
    await reset_after(
        services.urls["segmentation"], request[: rng.choice((len(request), 9_000))], rng.uniform(0, _LEAVES_AFTER_S)
    )


async def crash_on_a_stream(services: Services, rng: Random) -> None:
    """Dies on a control stream."""
    async with dying_connection(services.addresses["imitation"]) as address:
        client = ImitationClient(Channel(address))
        control = sequences.control(replace(services, imitation=client), _CALL_S, rng.randrange(8))
        sequence = await _begin(control, rng)
    await _end(sequence, client)


async def crash_in_a_session(services: Services, rng: Random) -> None:
    """Dies with a session open."""
    async with dying_connection(services.addresses["sim"]) as address:
        client = SimClient(Channel(address))
        session = sequences.session(replace(services, sim=client), _CALL_S, rng.randrange(8))
        sequence = await _begin(session, rng)
    await _end(sequence, client)


async def _begin(sequence: Coroutine[Any, Any, Answer], rng: Random) -> "asyncio.Task[Answer]":
    begun = asyncio.create_task(sequence)
    await asyncio.wait([begun], timeout=rng.uniform(0, _LEAVES_AFTER_S))
    return begun


async def _end(sequence: "asyncio.Task[Answer]", client: Client) -> None:
    """Waits until a client has noticed that its connection is broken."""
    with suppress(Unavailable):
        await sequence
    await client.close()


def hurry(questions: dict[Question, Answer]) -> Misuse:
    """Returns a client that allows its calls hardly any time: each is answered right or told that the time is over."""

    async def ask(services: Services, rng: Random) -> None:
        question = rng.choice(list(questions))
        with suppress(DeadlineExceeded, httpx.TimeoutException):
            check(await question(services, rng.uniform(0.0005, _LEAVES_AFTER_S)), questions[question])

    return ask


async def break_rules_of_sessions(services: Services, rng: Random) -> None:
    """Steps out of order, restores nonsense, steps what was closed, and leaves a session open."""
    sim, session = services.sim, await sequences.open_session(services, rng.randrange(8))
    up = np.zeros((2, 1), np.int64)
    await _refused(FailedPrecondition, sim.step(StepRequest(session, 1, up)))
    await sim.reset(ResetRequest(session))
    await _refused(StepOutOfOrder, sim.step(StepRequest(session, 7, up)))
    await _refused(InvalidInput, sim.restore(RestoreRequest(session, rng.randbytes(200))))
    await _refused(InvalidInput, sim.step(StepRequest(session, 1, np.full((2, 1), 99))))
    if rng.random() < 0.5:
        await sim.close_session(CloseSessionRequest(session))
        await _refused(SessionNotFound, sim.step(StepRequest(session, 1, up)))


async def break_rules_of_streams(services: Services, rng: Random) -> None:
    """Begins without a Hello, says it twice, repeats itself, and leaves in the middle."""
    hello, first = sequences.hello(services, 0), sequences.observed(services, 0, 0)
    await _refused(FailedPrecondition, sequences.converse(services, [first]))
    await _refused(FailedPrecondition, sequences.converse(services, [hello, first, hello]))
    await sequences.converse(services, [hello] + 9 * [first], heard=rng.randrange(4))


async def break_rules_of_rest(services: Services, rng: Random) -> None:
    """Sends what is no request."""
    url = rng.choice([services.urls[name] for name in ("segmentation", "imitation", "reward", "sim", "orchestrator")])
    path = rng.choice(("segment", "act", "reward", "create-session", "start-run", "nothing"))
    headers = {"content-type": "application/json"}
    reply = await services.rest.post(f"{url}/v1/{path}", content=rng.choice(_TEXTS), headers=headers)
    if reply.status_code not in (400, 404, 422):
        raise WrongAnswer(f"A request that is none was answered with {reply.status_code}.")


async def ask_for_what_is_not_there(services: Services, rng: Random) -> None:
    """Names runs, sessions and sizes that there are not."""
    await _refused(NotFound, services.orchestrator.get_run(GetRunRequest(_NOTHING)))
    await _refused(SessionNotFound, services.sim.step(StepRequest(_NOTHING, 1, np.zeros((1, 1), np.int64))))
    request = services.act_request(rng.randrange(8))
    small = replace(request.observation.images[0], height=1, width=1, data=bytes(3))
    await _refused(
        InvalidInput,
        services.imitation.act(replace(request, observation=replace(request.observation, images=(small,)))),
    )


async def _refused(error: type[ServiceError], call: Awaitable[object]) -> None:
    try:
        await call
    except error:
        return
    raise WrongAnswer(f"A call was answered that must be refused with {error.__name__}.")


CRASHES: tuple[Misuse, ...] = (crash_over_rest, crash_on_a_stream, crash_in_a_session)
BROKEN: tuple[Misuse, ...] = (
    break_rules_of_sessions,
    break_rules_of_streams,
    break_rules_of_rest,
    ask_for_what_is_not_there,
)
