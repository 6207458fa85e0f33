"""The command line's connections to services."""

import os
from typing import TypeVar

from freerein.cli.settings import CliSettings
from freerein.clients.channel import Channel, Client
from freerein.ports import address

C = TypeVar("C", bound=Client)


def connect(client: type[C], service: str) -> C:
    """Returns a client of a service, where the environment says that it is, or where `freerein up` puts it.

    Raises:
        InvalidInput: There is no such service, or its address is none.
    """
    return client(channel_to(address(service, os.environ), CliSettings()))


def channel_to(target: str, settings: CliSettings) -> Channel:
    """Returns a channel to the service at `target`, `host:port`."""
    return Channel(
        target,
        token=settings.token_text,
        root_certificates=settings.tls_cert.read_bytes() if settings.tls_cert else None,
    )
