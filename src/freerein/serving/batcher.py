"""One thread that runs the model, and items that wait for it: batches without waiting.

A lone item runs at once. What arrives while the model is busy forms the next batch, so the batch grows with the load
and nobody waits for a window to close.
"""

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from freerein.errors import DeadlineExceeded, ModelFault, Overloaded, ServiceError, Unavailable
from freerein.serving.metrics import Metrics

_log = logging.getLogger(__name__)
I = TypeVar("I")  # noqa: E741  # item
O = TypeVar("O")  # noqa: E741  # output

_FAULTS_UNTIL_NOT_READY = 5
_LAST_BATCH_S = 1.0


@dataclass(frozen=True)
class BatchResult(Generic[O]):
    """What came of an item.

    Attributes:
        output: The model's answer.
        queue_ns: How long it waited.
        infer_ns: How long its batch took.
        batch_size: How many items were in it.
    """

    output: O
    queue_ns: int
    infer_ns: int
    batch_size: int


@dataclass(eq=False)
class _Waiting(Generic[I, O]):
    item: I
    key: Hashable
    deadline: float
    future: "asyncio.Future[BatchResult[O]]"
    since_ns: int


class Batcher(Generic[I, O]):
    """Runs items through a model in batches, on a thread of its own.

    Args:
        call: The model: for a sequence of items the outputs in order, a `ServiceError` in place of an output for an
            item that fails alone. Called on the batcher's thread only.
        queue: How many items may wait.
        batch: How many items may share a call.
        metrics: Where the queue and the batches are measured.
    """

    def __init__(
        self, call: Callable[[Sequence[I]], Sequence[O | ServiceError]], *, queue: int, batch: int, metrics: Metrics
    ) -> None:
        self._call = call
        self._queue = queue
        self._batch = batch
        self._metrics = metrics
        self._waiting: deque[_Waiting[I, O]] = deque()
        self._lock = threading.Lock()  # held for `_waiting` and `_closed`
        self._bell = threading.Lock()  # free when the thread is to look; it wakes sooner than at a Condition
        self._closed = False
        self._faults = 0
        metrics.queued.set_function(lambda: len(self._waiting))
        self._thread = threading.Thread(target=self._work, name="model", daemon=True)
        self._thread.start()

    def not_ready(self) -> str:
        """Returns why the model cannot answer, empty when it can: its last five calls all failed."""
        return "The model failed five times in a row." if self._faults >= _FAULTS_UNTIL_NOT_READY else ""

    async def submit(self, item: I, *, key: Hashable = None, timeout_s: float) -> BatchResult[O]:
        """Returns what the model made of an item. Cancelled, it is dropped before it reaches the model.

        Args:
            item: The item.
            key: Only items of equal keys share a batch.
            timeout_s: Dropped when not begun within this time, in seconds.

        Raises:
            Overloaded: The queue is full.
            DeadlineExceeded: The time was up before the model could begin.
            ModelFault: The model raised on this item.
            Unavailable: The batcher is closed.
            ServiceError: Whatever the model returned in the item's place.
        """
        future: asyncio.Future[BatchResult[O]] = asyncio.get_running_loop().create_future()
        waiting = _Waiting(item, key, time.monotonic() + timeout_s, future, time.perf_counter_ns())
        with self._lock:
            if self._closed:
                raise _closed()
            if len(self._waiting) >= self._queue:
                raise Overloaded(
                    f"At most {self._queue} items may wait for the model; the queue is full.",
                    hint="Try again after Retry-After, or send less at once.",
                )
            self._waiting.append(waiting)
            self._ring()
        try:
            return await future
        except asyncio.CancelledError:
            self._withdraw(waiting)
            raise

    def close(self) -> None:
        """Ends the thread after the batch in work, or leaves it behind when that hangs; what waits is refused."""
        with self._lock:
            self._closed = True
            for waiting in self._waiting:
                _settle(waiting.future, _closed())
            self._waiting.clear()
            self._ring()
        self._thread.join(_LAST_BATCH_S)

    def _withdraw(self, waiting: "_Waiting[I, O]") -> None:
        """Frees the place of an item whose caller is gone."""
        with self._lock:
            if waiting in self._waiting:
                self._waiting.remove(waiting)

    def _ring(self) -> None:
        """Wakes the thread, which may be awake; the lock is held."""
        if self._bell.locked():
            self._bell.release()

    def _work(self) -> None:
        while batch := self._next_batch():
            begun_ns = time.perf_counter_ns()
            outputs = self._run([waiting.item for waiting in batch])
            infer_ns = time.perf_counter_ns() - begun_ns
            self._metrics.batches.observe(len(batch))
            for waiting, output in zip(batch, outputs, strict=True):
                if isinstance(output, ServiceError):
                    _settle(waiting.future, output)
                else:
                    _settle(waiting.future, BatchResult(output, begun_ns - waiting.since_ns, infer_ns, len(batch)))

    def _next_batch(self) -> list[_Waiting[I, O]]:
        """Returns the next items of one key, waiting for them; none when closed."""
        while True:
            while not self._waiting and not self._closed:
                self._bell.acquire()
            with self._lock:
                if self._closed:
                    return []
                batch = self._take()
            if live := [waiting for waiting in batch if _still_wanted(waiting)]:
                return live

    def _take(self) -> list[_Waiting[I, O]]:
        """Takes the items of the first one's key that stand at the front, up to a batch; the lock is held."""
        batch: list[_Waiting[I, O]] = []
        while self._waiting and len(batch) < self._batch and (not batch or self._waiting[0].key == batch[0].key):
            batch.append(self._waiting.popleft())
        return batch

    def _run(self, items: list[I]) -> Sequence[O | ServiceError]:
        """Calls the model; when it raises, once more for each item alone, so that only the poisonous one fails."""
        try:
            outputs = self._call(items)
            if len(outputs) != len(items):
                raise ValueError(f"the model answered {len(outputs)} items of {len(items)}")
        except Exception:  # whatever a model raises is a fault of the model
            _log.exception("the model failed", extra={"batch_size": len(items)})
            if len(items) > 1:
                return [self._run([item])[0] for item in items]
            self._faults += 1
            return [ModelFault("The model failed on this input; the log says more.", hint="Report it.")]
        self._faults = 0
        return outputs


def _closed() -> Unavailable:
    return Unavailable("The model must be running; the service is stopping.", hint="Call another replica.")


def _still_wanted(waiting: "_Waiting[I, O]") -> bool:
    if waiting.future.cancelled():
        return False
    if time.monotonic() > waiting.deadline:
        _settle(waiting.future, DeadlineExceeded("The model could not begin in time.", hint="Send less at once."))
        return False
    return True


def _settle(future: "asyncio.Future[BatchResult[O]]", result: "BatchResult[O] | ServiceError") -> None:
    """Sets a future of another thread's event loop, unless its caller is gone."""
    if not future.get_loop().is_closed():
        future.get_loop().call_soon_threadsafe(_set, future, result)


def _set(future: "asyncio.Future[BatchResult[O]]", result: "BatchResult[O] | ServiceError") -> None:
    if future.done():
        return
    if isinstance(result, ServiceError):
        future.set_exception(result)
    else:
        future.set_result(result)
