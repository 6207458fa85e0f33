"""The mixed load: clients that ask, follow sequences, die, hurry and break rules, many at a time."""

import asyncio
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from random import Random

from soak import misuse
from soak.questions import Answer, Question, Services, all_questions, check
from soak.sequences import all_sequences

CLIENTS = 12
_HUNG_S = 60.0
_ANSWER_S = 30.0
_WEIGHTS = {"plain calls": 30, "sequences": 44, "crashes": 6, "tiny deadlines": 6, "broken rules": 14}


@dataclass
class Tally:
    """The outcome of the load: how often each kind of client came, and the first lines of what went wrong."""

    clients: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)


class Load:
    """The load on the services.

    Args:
        services: The services, which do nothing else yet.
        seed: Of the choices.
    """

    def __init__(self, services: Services, *, seed: int) -> None:
        self.tally = Tally()
        self._services = services
        self._rng = Random(seed)
        self._plain: dict[Question, Answer] = {}
        self._sequences: dict[Question, Answer] = {}

    async def learn_answers(self) -> None:
        """Asks every question once, alone."""
        for questions, answers in ((all_questions(), self._plain), (all_sequences(), self._sequences)):
            for question in questions:
                answers[question] = await question(self._services, _ANSWER_S)

    async def run(self, seconds: float) -> None:
        """Lets clients come and go for a number of seconds."""
        until = time.monotonic() + seconds

        async def come_and_go() -> None:
            while time.monotonic() < until:
                await self._come()

        await asyncio.gather(*(come_and_go() for _ in range(CLIENTS)))

    async def _come(self) -> None:
        kind = self._rng.choices(list(_WEIGHTS), list(_WEIGHTS.values()))[0]
        client = self._client(kind)
        try:
            async with asyncio.timeout(_HUNG_S):
                await client()
        except TimeoutError:
            self.tally.failures.append(f"{kind}: hung for {_HUNG_S:.0f} s")
        except Exception as error:  # whatever it is, the soak has failed, and goes on
            self.tally.failures.append(f"{kind}: {type(error).__name__}: {error}")
        self.tally.clients[kind] += 1

    def _client(self, kind: str) -> Callable[[], Awaitable[None]]:
        match kind:
            case "plain calls":
                return lambda: self._ask(self._plain)
            case "sequences":
                return lambda: self._ask(self._sequences)
            case "crashes":
                ill_behaved = self._rng.choice(misuse.CRASHES)
            case "tiny deadlines":
                ill_behaved = misuse.hurry(self._plain)
            case _:
                ill_behaved = misuse.break_rules
        return lambda: ill_behaved(self._services, self._rng)

    async def _ask(self, known: dict[Question, Answer]) -> None:
        question = self._rng.choice(list(known))
        check(await question(self._services, _ANSWER_S), known[question])
