"""Starts a service as a process of its own, as it runs for users."""

import os
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

from freerein.cli.services import Stack, choose, free_ports

_START_S = 60.0


@asynccontextmanager
async def running(service: str, *, data_dir: Path, module: str = "", **environ: str) -> AsyncGenerator[Stack, None]:
    """Runs a service on free ports for as long as the block does; it is ready when the block begins.

    Args:
        service: The service's name.
        data_dir: Its data directory.
        module: What `python -m` runs; empty for the service as it is installed.
        environ: Added to the environment.
    """
    ports = free_ports([service])
    modules = {service: module} if module else choose([service])
    async with Stack(modules, data_dir=data_dir, environ={**os.environ, **environ}, ports=ports) as stack:
        await stack.ready(timeout_s=_START_S)
        yield stack
