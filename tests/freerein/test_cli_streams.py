"""A stream that is opened again: how long a service may be away, and what counts as having been there."""

import asyncio
from collections.abc import AsyncGenerator

import pytest

from freerein.cli.jobs.streams import reconnecting
from freerein.errors import Unavailable

TIMEOUT_S = 0.1


class Flaky:
    """A stream that breaks off after each of some silences, in seconds, and says one thing after the last."""

    def __init__(self, *silences_s: float) -> None:
        self._silences_s = list(silences_s)

    async def open(self) -> AsyncGenerator[str, None]:
        if self._silences_s:
            await asyncio.sleep(self._silences_s.pop(0))
            raise Unavailable("The service went away.")
        yield "back"


async def test_a_stream_that_was_quiet_for_longer_than_its_service_may_be_away_is_opened_again() -> None:
    quiet = Flaky(2 * TIMEOUT_S, 2 * TIMEOUT_S)
    assert [item async for item in reconnecting(quiet.open, timeout_s=TIMEOUT_S)] == ["back"]


async def test_a_service_that_stays_away_is_given_up() -> None:
    away = Flaky(*[0.0] * 100)
    with pytest.raises(Unavailable, match="went away"):
        await anext(reconnecting(away.open, timeout_s=TIMEOUT_S))
