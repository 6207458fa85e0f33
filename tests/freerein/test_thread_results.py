"""Results of a thread reach the futures of an event loop, as long as there is one."""

import asyncio
import gc
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import uvloop

from freerein.serving.thread_results import ThreadResults

FILES = Path("/proc/self/fd")
LOOPS = pytest.mark.parametrize("run", [asyncio.run, uvloop.run])


@LOOPS
def test_results_and_exceptions_complete_their_futures(run: Callable[..., Any]) -> None:
    async def main() -> list[object]:
        loop = asyncio.get_running_loop()
        results = ThreadResults[int](loop)
        futures = [loop.create_future() for _ in range(3)]
        futures[0].cancel()

        def work() -> None:
            for future, result in zip(futures, (1, 2, ZeroDivisionError("3")), strict=True):
                results.put(future, result)
            results.send()

        threading.Thread(target=work).start()
        return await asyncio.gather(*futures, return_exceptions=True)

    cancelled, done, failed = run(main())
    assert isinstance(cancelled, asyncio.CancelledError)
    assert done == 2
    assert isinstance(failed, ZeroDivisionError)


async def test_more_results_than_the_pipe_holds_are_delivered() -> None:
    loop = asyncio.get_running_loop()
    results, count = ThreadResults[int](loop), 70_000
    futures = [loop.create_future() for _ in range(count)]
    for number, future in enumerate(futures):
        results.put(future, number)
        results.send()  # the loop does not read meanwhile
    assert sum(await asyncio.gather(*futures)) == sum(range(count))


@LOOPS
def test_a_closed_loop_gets_nothing_and_its_pipe_is_closed(run: Callable[..., Any]) -> None:
    async def main() -> tuple[ThreadResults[int], "asyncio.Future[int]"]:
        loop = asyncio.get_running_loop()
        return ThreadResults(loop), loop.create_future()

    gc.collect()
    before = len(list(FILES.iterdir()))
    results, future = run(main())
    results.put(future, 1)
    results.send()
    assert not future.done()
    del results, future
    gc.collect()
    assert len(list(FILES.iterdir())) <= before
