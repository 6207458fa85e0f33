"""The events of a job as they happen."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import Executor
from typing import Any

from freerein.jobs.store import JobStore


async def watch(
    store: JobStore,
    job_id: str,
    *,
    from_sequence: int,
    pause: Callable[[bool], Awaitable[bool]],
    threads: Executor | None = None,
) -> AsyncIterator[tuple[int, dict[str, Any]]]:
    """Yields sequence numbers and the fields of a job after each event; ends after the event that ends the job.

    A watcher is only a position in a file: however slow it is, the job does not wait for it.

    Args:
        store: The jobs.
        job_id: The job.
        from_sequence: First event wanted.
        pause: Awaited while there is no new event, with whether there was one since the last pause; returns False to
            end the stream.
        threads: Where files are read; None for the default executor of the event loop.
    """
    events, loop = store.events(job_id), asyncio.get_running_loop()
    sequence, ended, is_new = 0, False, False
    while True:
        while new := await loop.run_in_executor(threads, events):
            is_new = True
            for event in new:
                ended = event.ended
                if sequence >= from_sequence:
                    yield sequence, await loop.run_in_executor(threads, store.fields, job_id, event)
                sequence += 1
        if ended or not await pause(is_new):
            return
        is_new = False
