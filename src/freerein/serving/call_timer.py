"""Measures where the time of one call goes, for `Timing` in its reply."""

import time
from collections.abc import Awaitable
from typing import TypeVar

from freerein.serving.batcher import BatchResult
from freerein.types.common import Timing

T = TypeVar("T")


class CallTimer:
    """Starts when constructed. Time that is neither decoding, queueing nor inference counts as encoding."""

    def __init__(self) -> None:
        self._start_ns = time.perf_counter_ns()
        self._decode_ns = self._queue_ns = self._infer_ns = self._batch_size = 0

    async def decode(self, work: Awaitable[T]) -> T:
        """Awaits work that checks and decodes inputs."""
        start_ns = time.perf_counter_ns()
        result = await work
        self._decode_ns += time.perf_counter_ns() - start_ns
        return result

    def output(self, done: BatchResult[T]) -> T:
        """Returns the model's output, which has just arrived."""
        self._infer_ns += done.infer_ns
        self._queue_ns += time.perf_counter_ns() - done.submitted_ns - done.infer_ns
        self._batch_size = max(self._batch_size, done.batch_size)
        return done.output

    def timing(self) -> Timing:
        """Returns the times up to now."""
        total_ns = time.perf_counter_ns() - self._start_ns
        return Timing(
            queue_ns=self._queue_ns,
            decode_ns=self._decode_ns,
            infer_ns=self._infer_ns,
            encode_ns=total_ns - self._queue_ns - self._decode_ns - self._infer_ns,
            total_ns=total_ns,
            batch_size=self._batch_size,
        )
