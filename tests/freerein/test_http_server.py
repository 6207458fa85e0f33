"""How a server begins to stop: at once, or after a delay in which it is not ready and answers as before."""

import asyncio
import signal
from typing import Any

import pytest
from starlette.types import Receive, Scope, Send

from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.rest.http_server import HttpServer, make_server


async def answer(_scope: Scope, _receive: Receive, _send: Send) -> None:
    """Answers nothing."""


@pytest.fixture
def health() -> Health:
    return Health()


def server_with(health: Health, **bounds: Any) -> HttpServer:
    return make_server(answer, limits=Limits(**bounds), health=health, cert=None, key=None)


def test_a_signal_begins_the_drain_at_once(health: Health) -> None:
    server = server_with(health)
    assert health.reason() == ""
    server.handle_exit(signal.SIGTERM, None)
    assert (health.draining, server.should_exit) == (True, True)


async def test_with_a_delay_it_is_only_not_ready_until_then(health: Health) -> None:
    server = server_with(health, drain_delay_s=0.05)
    server.handle_exit(signal.SIGTERM, None)
    assert (health.draining, server.should_exit, health.reason()) == (False, False, "It is about to drain.")
    async with asyncio.timeout(60):
        while not await server.on_tick(1):
            assert not health.draining
    assert (health.draining, health.reason()) == (True, "It is draining.")


async def test_a_second_signal_ends_the_delay(health: Health) -> None:
    server = server_with(health, drain_delay_s=600.0)
    server.handle_exit(signal.SIGTERM, None)
    assert not await server.on_tick(1)
    server.handle_exit(signal.SIGTERM, None)
    assert (health.draining, server.should_exit) == (True, True)
