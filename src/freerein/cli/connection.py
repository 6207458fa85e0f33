"""Connections of the command line to services."""

import asyncio
import os
from collections.abc import Awaitable, Callable
from typing import TypeVar

from freerein.cli.settings import CliSettings
from freerein.clients.channel import Channel
from freerein.clients.rpc import Client
from freerein.ports import address

C = TypeVar("C", bound=Client)
T = TypeVar("T")


def connect(client: type[C], service: str) -> C:
    """Returns a client of a service at its address in the environment, by default that of `freerein up`.

    Raises:
        InvalidInput: The service or its address is invalid.
    """
    return client(channel_to(address(service, os.environ), CliSettings()))


def call(client: type[C], service: str, use: Callable[[C], Awaitable[T]]) -> T:
    """Returns what a coroutine function does with a connected client; raises as `connect` and the function."""

    async def connected() -> T:
        async with connect(client, service) as opened:
            return await use(opened)

    return asyncio.run(connected())


def channel_to(target: str, settings: CliSettings) -> Channel:
    """Returns a channel to `host:port`."""
    return Channel(
        target,
        token=settings.token_text,
        root_certificates=settings.tls_cert.read_bytes() if settings.tls_cert else None,
    )
