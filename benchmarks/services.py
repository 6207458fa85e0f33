"""Starts a service as a process of its own, as it runs for users."""

import os
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

from freerein.cli.services import choose, free_ports
from freerein.cli.supervisor import Stack

_START_S = 60.0


@asynccontextmanager
async def running(service: str, *, data_dir: Path, **environ: str) -> AsyncGenerator[Stack, None]:
    """Runs a service on free ports for as long as the block does; it is ready when the block begins.

    Args:
        service: The service's name.
        data_dir: Its data directory.
        environ: Added to the environment.
    """
    ports = free_ports([service])
    async with Stack(choose([service]), data_dir=data_dir, environ={**os.environ, **environ}, ports=ports) as stack:
        await stack.ready(timeout_s=_START_S)
        yield stack
