"""The command line's connection to a service."""

import os

from freerein.cli.settings import CliSettings
from freerein.clients.channel import Channel
from freerein.ports import address


def open_channel(service: str, settings: CliSettings) -> Channel:
    """Returns a channel to a service, where the environment says that it is, or where `freerein up` puts it.

    Raises:
        InvalidInput: There is no such service, or its address is none.
    """
    return Channel(
        address(service, os.environ),
        token=settings.token.get_secret_value() if settings.token else "",
        root_certificates=settings.tls_cert.read_bytes() if settings.tls_cert else None,
    )
