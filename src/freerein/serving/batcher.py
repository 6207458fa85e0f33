"""Dynamic batching without a waiting window, on one model thread.

A lone item runs at once. Items that arrive while the model is busy form the next batch, so batches grow with the load.
"""

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from freerein.errors import DeadlineExceeded, ModelFault, Overloaded, ServiceError, Unavailable
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.thread_results import ThreadResults

_log = logging.getLogger(__name__)
I = TypeVar("I")  # noqa: E741  # item
O = TypeVar("O")  # noqa: E741  # output

_FAULTS_UNTIL_NOT_READY = 5
_CLOSE_TIMEOUT_S = 1.0
_HANGS_AFTER_CALLS = 4.0


@dataclass(frozen=True)
class BatchResult(Generic[O]):
    """The output for one item, when it was submitted, nanoseconds in the model, and the items in that call of it.

    `submitted_ns` is on the clock of `time.perf_counter_ns`.
    """

    output: O
    submitted_ns: int
    infer_ns: int
    batch_size: int


@dataclass(eq=False)
class _QueuedItem(Generic[I, O]):
    item: I
    key: Hashable
    deadline: float
    future: "asyncio.Future[BatchResult[O]]"
    results: ThreadResults[BatchResult[O]]
    submitted_ns: int

    def resolve(self, result: "BatchResult[O] | ServiceError") -> None:
        self.results.put(self.future, result)
        self.results.send()


class Batcher(Generic[I, O]):
    """Runs items through a model in batches, on its own thread.

    Args:
        call: The model: returns the outputs of a sequence of items in order, a `ServiceError` in place of the output
            of an item that fails alone. Called on the batcher's thread only.
        queue: Largest number of queued items.
        batch: Largest number of items in one model call.
        metrics: Measures queue length, batch sizes and whether the thread is stuck.
        call_s: Longest time of an item in the queue, in seconds, unless it is submitted with another; seconds after
            which a model call is stuck; after four times that the model hangs.
    """

    def __init__(
        self,
        call: Callable[[Sequence[I]], Sequence[O | ServiceError]],
        *,
        queue: int,
        batch: int,
        metrics: Metrics,
        call_s: float = Limits.unary_s,
    ) -> None:
        self._call = call
        self._call_s = call_s
        self._call_began: float | None = None
        self._max_queue = queue
        self._max_batch = batch
        self._metrics = metrics
        self._queue: deque[_QueuedItem[I, O]] = deque()
        self._lock = threading.Lock()  # guards `_queue` and `_closed`
        self._wake = threading.Lock()  # released to wake the thread: lower latency than a Condition
        self._closed = False
        self._faults = 0
        self._last_fault = 0.0
        self._results: ThreadResults[BatchResult[O]] | None = None
        metrics.queued.set_function(lambda: len(self._queue))
        metrics.stuck.set_function(lambda: self._in_call_s() > self._call_s)
        self._thread = threading.Thread(target=self._work, name="model", daemon=True)
        self._thread.start()

    def not_ready(self) -> str:
        """Returns why the model cannot answer, empty when it can: not when stuck, nor after five failures in a row.

        `call_s` after the last failure it may be asked again: nobody calls a service that is not ready.
        """
        if self._in_call_s() > self._call_s:
            return f"The model has been busy with one call for more than {self._call_s:g} s."
        is_recent = time.monotonic() - self._last_fault < self._call_s
        return "The model failed five times in a row." if self._faults >= _FAULTS_UNTIL_NOT_READY and is_recent else ""

    def hangs(self) -> bool:
        """Returns whether the model has been stuck for so long that only a new process helps."""
        return self._in_call_s() > _HANGS_AFTER_CALLS * self._call_s

    async def submit(self, item: I, *, key: Hashable = None, timeout_s: float | None = None) -> BatchResult[O]:
        """Returns the model's output for an item. A cancelled item is removed from the queue.

        Args:
            item: The item.
            key: Only items of equal keys share a batch.
            timeout_s: Longest time in the queue, in seconds; None for `call_s`.

        Raises:
            Overloaded: The queue is full.
            DeadlineExceeded: The item was still queued after `timeout_s`.
            ModelFault: The model raised on this item.
            Unavailable: The batcher is closed.
            ServiceError: Whatever the model returned in place of the item's output.
        """
        (queued,) = self._enqueue([item], key=key, timeout_s=timeout_s)
        try:
            return await queued.future
        except asyncio.CancelledError:
            self._remove(queued)
            raise

    async def submit_batch(self, items: Sequence[I]) -> list[BatchResult[O] | ServiceError]:
        """Returns the model's outputs, or errors as of `submit`, for items that share a batch with no others.

        So equal items have equal outputs, to the bit. More than a batch or the queue holds are several, one after the
        other.

        Raises:
            Overloaded: The queue has no room for a batch.
            Unavailable: The batcher is closed.
        """
        found: list[Any] = []
        size = min(self._max_batch, self._max_queue)
        for first in range(0, len(items), size):
            queued = self._enqueue(items[first : first + size], key=object(), timeout_s=None)
            try:
                found += await asyncio.gather(*(each.future for each in queued), return_exceptions=True)
            except asyncio.CancelledError:
                for each in queued:
                    self._remove(each)
                raise
        return found

    def _enqueue(self, items: Sequence[I], *, key: Hashable, timeout_s: float | None) -> "list[_QueuedItem[I, O]]":
        """Queues items one behind the other."""
        loop = asyncio.get_running_loop()
        if self._results is None or self._results.loop is not loop:
            self._results = ThreadResults(loop)
        results, submitted_ns = self._results, time.perf_counter_ns()
        deadline = time.monotonic() + (self._call_s if timeout_s is None else timeout_s)
        queued = [_QueuedItem(item, key, deadline, loop.create_future(), results, submitted_ns) for item in items]
        with self._lock:
            if self._closed:
                raise _closed_error()
            if len(self._queue) + len(queued) > self._max_queue:
                raise Overloaded(
                    f"At most {self._max_queue} items may wait for the model; the queue is full.",
                    hint="Try again after Retry-After, or send less at once.",
                )
            self._queue.extend(queued)
            self._wake_thread()
        return queued

    def close(self) -> None:
        """Refuses queued items and ends the thread after its current batch; abandons a thread that hangs."""
        with self._lock:
            self._closed = True
            self._refuse_queued()
            self._wake_thread()
        self._thread.join(_CLOSE_TIMEOUT_S)

    def _in_call_s(self) -> float:
        """Returns for how many seconds the current model call has run, 0 when there is none."""
        began = self._call_began
        return 0.0 if began is None else time.monotonic() - began

    def _refuse_queued(self) -> None:
        """Refuses all queued items; `_lock` is held."""
        while self._queue:
            self._queue.popleft().resolve(_closed_error())

    def _remove(self, queued: "_QueuedItem[I, O]") -> None:
        with self._lock:
            if queued in self._queue:
                self._queue.remove(queued)

    def _wake_thread(self) -> None:
        """Wakes the thread, which may be awake; `_lock` is held."""
        if self._wake.locked():
            self._wake.release()

    def _work(self) -> None:
        while batch := self._next_batch():
            self._metrics.batches.observe(len(batch))
            started_ns = time.perf_counter_ns()
            try:
                with self._timed():
                    outputs = self._call([queued.item for queued in batch])
                if len(outputs) != len(batch):
                    raise ValueError(f"the model returned {len(outputs)} outputs for {len(batch)} items")
            except Exception:  # whatever a model raises is a fault of the model
                _log.exception("the model failed", extra={"batch_size": len(batch)})
                self._fail(batch)
            else:
                self._faults = 0
                _answer(batch, outputs, infer_ns=time.perf_counter_ns() - started_ns)

    @contextmanager
    def _timed(self) -> Iterator[None]:
        """Times a call of the model; callers that have their answers find the model idle."""
        self._call_began = time.monotonic()
        try:
            yield
        finally:
            self._call_began = None

    def _fail(self, batch: list[_QueuedItem[I, O]]) -> None:
        """Has each item of a batch run again alone, so that only the faulty ones fail; fails one that was alone.

        Their deadlines stay: one that has passed while the batch failed is exceeded.
        """
        if len(batch) == 1:
            self._last_fault = time.monotonic()
            self._faults += 1
            batch[0].resolve(ModelFault("The model failed on this input; the log holds the cause.", hint="Report it."))
            return
        for queued in batch:
            queued.key = object()
        with self._lock:
            self._queue.extendleft(reversed(batch))
            if self._closed:
                self._refuse_queued()

    def _next_batch(self) -> list[_QueuedItem[I, O]]:
        """Waits for items and returns the next batch; empty when closed."""
        while True:
            while not self._queue and not self._closed:
                self._wake.acquire()
            with self._lock:
                if self._closed:
                    return []
                batch = self._take()
            if live := [queued for queued in batch if _is_live(queued)]:
                return live

    def _take(self) -> list[_QueuedItem[I, O]]:
        """Removes up to a batch of items of equal key from the front of the queue; `_lock` is held."""
        batch: list[_QueuedItem[I, O]] = []
        while self._queue and len(batch) < self._max_batch and (not batch or self._queue[0].key == batch[0].key):
            batch.append(self._queue.popleft())
        return batch


def _answer(batch: "list[_QueuedItem[I, O]]", outputs: Sequence[O | ServiceError], *, infer_ns: int) -> None:
    for queued, output in zip(batch, outputs, strict=True):
        if isinstance(output, ServiceError):
            queued.results.put(queued.future, output)
        else:
            queued.results.put(queued.future, BatchResult(output, queued.submitted_ns, infer_ns, len(batch)))
    for results in {queued.results for queued in batch}:  # of one event loop, as a rule
        results.send()


def _closed_error() -> Unavailable:
    return Unavailable("The model must be running; the service is stopping.", hint="Call another replica.")


def _is_live(queued: "_QueuedItem[I, O]") -> bool:
    if queued.future.cancelled():
        return False
    if time.monotonic() > queued.deadline:
        queued.resolve(DeadlineExceeded("The model could not start in time.", hint="Send less at once."))
        return False
    return True
