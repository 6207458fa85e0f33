"""Ill-behaved clients: they die in the middle of a call, have hardly any time, or break the rules."""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from dataclasses import replace
from random import Random
from typing import Any

import httpx

from freerein.clients import Channel, ImitationClient, SimClient
from freerein.errors import DeadlineExceeded, Unavailable
from soak import sequences
from soak.crashing import dying_connection
from soak.questions import Answer, Question, Services, WrongAnswer, check, segment_over_rest

_CALL_S, _LEAVES_AFTER_S = 30.0, 0.03
_TEXTS = (b"", b"{", b'{"frames": NaN}', b'{"frames": {}, "secret": 1}', b"\xff\xfe", b"[" * 5_000)

_SEQUENCES = (("imitation", ImitationClient, sequences.control), ("sim", SimClient, sequences.session))

Misuse = Callable[[Services, Random], Awaitable[None]]


async def crash_over_rest(services: Services, rng: Random) -> None:
    """Dies while its request is on its way, or before the reply has come."""
    async with dying_connection(services.urls["segmentation"].removeprefix("http://")) as address:
        victim = replace(services, urls={"segmentation": f"http://{address}"})
        call = await _begin(segment_over_rest(victim, _CALL_S, rng.randrange(16)), rng)
    await _end(call)


async def crash_over_grpc(services: Services, rng: Random) -> None:
    """Dies on a control stream, or with a session open."""
    name, client, sequence = rng.choice(_SEQUENCES)
    async with dying_connection(services.addresses[name]) as address:
        dying = client(Channel(address))
        changed: dict[str, Any] = {name: dying}
        call = await _begin(sequence(replace(services, **changed), _CALL_S, rng.randrange(8)), rng)
    await _end(call)
    await dying.close()


async def _begin(sequence: Coroutine[Any, Any, Answer], rng: Random) -> "asyncio.Task[Answer]":
    begun = asyncio.create_task(sequence)
    await asyncio.wait([begun], timeout=rng.uniform(0, _LEAVES_AFTER_S))
    return begun


async def _end(call: "asyncio.Task[Answer]") -> None:
    """Waits until a client has noticed that its connection is broken."""
    with suppress(Unavailable, httpx.TransportError):
        await call


def hurry(questions: dict[Question, Answer]) -> Misuse:
    """Returns a client that allows its calls hardly any time: each is answered right or told that the time is over."""

    async def ask(services: Services, rng: Random) -> None:
        question = rng.choice(list(questions))
        with suppress(DeadlineExceeded, httpx.TimeoutException):
            check(await question(services, rng.uniform(0.0005, _LEAVES_AFTER_S)), questions[question])

    return ask


async def break_rules(services: Services, rng: Random) -> None:
    """Sends what is no request."""
    url = rng.choice([services.urls[name] for name in ("segmentation", "imitation", "reward", "sim", "orchestrator")])
    path = rng.choice(("segment", "act", "reward", "create-session", "start-run", "nothing"))
    headers = {"content-type": "application/json"}
    reply = await services.rest.post(f"{url}/v1/{path}", content=rng.choice(_TEXTS), headers=headers)
    if reply.status_code not in (400, 404, 422):
        raise WrongAnswer(f"A request that is none was answered with {reply.status_code}.")


CRASHES: tuple[Misuse, ...] = (crash_over_rest, crash_over_grpc)
