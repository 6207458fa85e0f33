"""Servers of the benchmarks' own, each a process: it prints its port, and ends when its input does."""

import asyncio
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

_END_S = 10.0


@asynccontextmanager
async def serving(module: str, *arguments: str) -> AsyncGenerator[int, None]:
    """Runs `python -m MODULE ARGUMENTS` for as long as the block does; yields the port that it listens on.

    Raises:
        RuntimeError: It ended before it listened.
    """
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-m", module, *arguments, stdin=pipe, stdout=pipe)
    if process.stdin is None or process.stdout is None:
        raise TypeError("asyncio must connect the pipes that it was asked for")
    try:
        line = await process.stdout.readline()
        if not line:
            raise RuntimeError(f"`python -m {module} {' '.join(arguments)}` must print its port; it ended before.")
        yield int(line)
    finally:
        process.stdin.close()
        await asyncio.wait_for(process.wait(), _END_S)


async def until_input_ends(port: int) -> None:
    """Tells the parent process where this one listens; returns when the parent has enough, or is gone."""
    sys.stdout.write(f"{port}\n")
    sys.stdout.flush()
    await asyncio.to_thread(sys.stdin.buffer.read)
