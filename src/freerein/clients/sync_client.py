"""A blocking wrapper of any client, with its event loop in a thread of its own.

    with SyncClient(SimClient(Channel("127.0.0.1:9104"))) as sim:
        tasks = sim.list_tasks(ListTasksRequest())

The thread makes it work where a loop is already running, as in notebooks; it costs a tenth of a millisecond per call.
"""

import asyncio
import os
import threading
import weakref
from collections.abc import AsyncGenerator, Callable, Coroutine, Generator
from concurrent.futures import CancelledError, Future
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from typing_extensions import Self

from freerein.clients.rpc import Client
from freerein.errors import Cancelled, FailedPrecondition

T = TypeVar("T")
_END_S = 1.0
_Started = tuple[asyncio.AbstractEventLoop, asyncio.Event]


if TYPE_CHECKING:
    from freerein.clients import services

    class _EveryRpc(
        services.SimClient,
        services.SegmentationClient,
        services.ImitationClient,
        services.RewardClient,
        services.OrchestratorClient,
        services.FitClient,
        services.ModelClient,
    ): ...
else:
    _EveryRpc = object


class SyncClient(_EveryRpc):
    """A client whose methods block, and whose asynchronous iterators are plain iterators. Thread-safe.

    Type checkers see the RPCs of all services; it has those of its client.

    Args:
        client: The client, owned by this object from now on: closed by `close`, on garbage collection, or at exit.
    """

    def __init__(self, client: Client) -> None:
        started: Future[_Started] = Future()
        thread = threading.Thread(
            target=asyncio.run, args=(_serve(client, started),), name=type(client).__name__, daemon=True
        )
        thread.start()
        self._thread = thread
        self._client = client
        self._process_id = os.getpid()
        self._loop, stop = started.result()
        self._stop = weakref.finalize(self, _end, self._loop, stop, thread)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name.startswith("_"):
            raise AttributeError(name)
        method = getattr(self._client, name)

        def call(*args: object, **kwargs: object) -> object:
            self._check()
            reply = method(*args, **kwargs)  # neither has begun: a channel opens on the running loop
            return self._iterate(_Replies(reply)) if isinstance(reply, AsyncGenerator) else self._wait(reply)

        return call

    def close(self) -> None:  # type: ignore[override]  # it blocks, too
        """Closes the client and ends the thread; may be called twice."""
        self._stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _check(self) -> None:
        if not self._stop.alive:
            raise FailedPrecondition("The client must be open; it is closed.", hint="Make another one.")
        if self._process_id != os.getpid():  # its thread was not forked
            raise FailedPrecondition(
                "A client must be used in the process that made it; this process was forked from that one.",
                hint="Make it in the new process, started by spawn or forkserver.",
            )

    def _wait(self, reply: Coroutine[Any, Any, T]) -> T:
        future = asyncio.run_coroutine_threadsafe(reply, self._loop)
        try:
            return future.result()
        except CancelledError:
            raise Cancelled("The client was closed while it waited for an answer.") from None
        except BaseException:  # KeyboardInterrupt here cancels the call there
            future.cancel()
            raise

    def _iterate(self, replies: "_Replies[T]") -> Generator[T, None, None]:
        try:
            while True:
                self._check()
                yield self._wait(replies.next())
        except StopAsyncIteration:
            return
        finally:
            if threading.current_thread() is self._thread:  # the garbage collector's: the loop cannot wait for itself
                asyncio.run_coroutine_threadsafe(replies.close(), self._loop)
            elif self._stop.alive:
                self._wait(replies.close())


class _Replies(Generic[T]):
    """The replies of a stream, on the event loop."""

    def __init__(self, replies: AsyncGenerator[T, None]) -> None:
        self._replies = replies
        self._waiting: asyncio.Task[T] | None = None

    async def next(self) -> T:
        self._waiting = asyncio.current_task()
        return await anext(self._replies)

    async def close(self) -> None:
        """Ends the stream, while a reply is awaited, too."""
        if self._waiting:
            self._waiting.cancel()
            await asyncio.wait([self._waiting])
        await self._replies.aclose()


async def _serve(client: Client, started: "Future[_Started]") -> None:
    stop = asyncio.Event()
    started.set_result((asyncio.get_running_loop(), stop))
    await stop.wait()
    await client.close()
    # Let cancelled gRPC calls finish: gRPC logs errors if the loop is closed before.
    if unfinished := asyncio.all_tasks() - {asyncio.current_task()}:
        await asyncio.wait(unfinished, timeout=_END_S)


def _end(loop: asyncio.AbstractEventLoop, stop: asyncio.Event, thread: threading.Thread) -> None:
    loop.call_soon_threadsafe(stop.set)
    if thread is not threading.current_thread():  # the garbage collector may run on any thread
        thread.join()
