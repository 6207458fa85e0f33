"""Connections of the command line to services."""

import asyncio
import os
from collections.abc import Awaitable, Callable, Mapping
from typing import TypeVar

import typer

from freerein.cli.settings import CliSettings
from freerein.clients.channel import Channel
from freerein.clients.rpc import Client
from freerein.errors import NotFound, ServiceError, Unavailable
from freerein.ports import address

SEGMENT_TIMEOUT_S = 600.0  # of a trajectory of any length

C = TypeVar("C", bound=Client)
T = TypeVar("T")


def connect(client: type[C], service: str) -> C:
    """Returns a client of a service at its address in the environment, by default that of `freerein up`."""
    return client(channel_to(address(service, os.environ), CliSettings()))


def call(client: type[C], service: str, use: Callable[[C], Awaitable[T]]) -> T:
    """Returns what a coroutine function does with a connected client."""
    return asyncio.run(_call(client, service, use))


def call_each(
    clients: Mapping[str, type[C]], use: Callable[[C], Awaitable[T]]
) -> tuple[dict[str, T], dict[str, ServiceError]]:
    """Returns the answers of several services, at least one, and the errors of the others, by service.

    Raises ServiceError where no service has an answer: NotFound only where each of them runs and says so.
    """

    async def answer(service: str) -> T | ServiceError:
        try:
            return await _call(clients[service], service, use)
        except ServiceError as error:
            return error

    async def ask() -> list[T | ServiceError]:
        return await asyncio.gather(*map(answer, clients))

    replies = dict(zip(clients, asyncio.run(ask()), strict=True))
    answers = {service: reply for service, reply in replies.items() if not isinstance(reply, ServiceError)}
    errors = {service: reply for service, reply in replies.items() if isinstance(reply, ServiceError)}
    if not answers:
        check_all_answer({name: error for name, error in errors.items() if not isinstance(error, NotFound)})
        raise next(iter(errors.values()))
    return answers, errors


def check_only_unavailable(errors: Mapping[str, ServiceError]) -> None:
    """Prints which services do not answer; raises the first error of a service that does."""
    for error in errors.values():
        if not isinstance(error, Unavailable):
            raise error
    if errors:
        typer.echo(f"Not running, so not listed: {', '.join(errors)}.", err=True)


def check_all_answer(errors: Mapping[str, ServiceError]) -> None:
    """Raises Unavailable with the names of services that do not answer; the first error of a service that does."""
    for error in errors.values():
        if not isinstance(error, Unavailable):
            raise error
    if errors:
        raise Unavailable(
            f"A service that has what is asked for must answer; no answer came from {', '.join(errors)}.",
            hint="Start what does not run, or check FREEREIN_<SERVICE>_ADDRESS.",
        ) from next(iter(errors.values()))


async def _call(client: type[C], service: str, use: Callable[[C], Awaitable[T]]) -> T:
    async with connect(client, service) as connected:
        return await use(connected)


def channel_to(target: str, settings: CliSettings) -> Channel:
    """Returns a channel to `host:port`."""
    return Channel(
        target,
        token=settings.token_text,
        root_certificates=settings.tls_cert.read_bytes() if settings.tls_cert else None,
    )
