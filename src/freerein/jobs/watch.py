"""The events of a job as they happen."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import Executor

from freerein.jobs.store import JobEvent, JobStore


async def watch_events(
    store: JobStore,
    job_id: str,
    *,
    from_sequence: int,
    pause: Callable[[bool], Awaitable[bool]],
    threads: Executor | None = None,
) -> AsyncIterator[JobEvent]:
    """Yields the events of a job from a sequence number on; ends after the event that ends the job.

    A watcher is only a position in a file: however slow it is, the job does not wait for it.

    Args:
        store: The jobs.
        job_id: The job.
        from_sequence: First event wanted.
        pause: Awaited while there is no new event, with whether there was one since the last pause; returns False to
            end the stream.
        threads: Where the file is read; None for the default executor of the event loop.
    """
    reader, ended, is_new = store.events(job_id), False, False
    while True:
        while events := await asyncio.get_running_loop().run_in_executor(threads, reader.read):
            is_new = True
            for event in events:
                ended = event.ended
                if event.sequence >= from_sequence:
                    yield event
        if ended or not await pause(is_new):
            return
        is_new = False
