"""Where the time of a call went that decodes and infers in turns."""

import time
from collections.abc import Awaitable
from typing import TypeVar

from freerein.serving.batcher import BatchResult
from freerein.types.common import Timing

T = TypeVar("T")


class Stopwatch:
    """Runs from its making; what is neither decoding nor the model's is encoding."""

    def __init__(self) -> None:
        self._begun_ns = time.perf_counter_ns()
        self._decode_ns = self._queue_ns = self._infer_ns = self._batch_size = 0

    async def decoding(self, work: Awaitable[T]) -> T:
        """Awaits work that makes bytes into arrays."""
        begun_ns = time.perf_counter_ns()
        result = await work
        self._decode_ns += time.perf_counter_ns() - begun_ns
        return result

    async def inferring(self, work: Awaitable[BatchResult[T]]) -> T:
        """Awaits the model, and returns its output."""
        begun_ns = time.perf_counter_ns()
        done = await work
        self._infer_ns += done.infer_ns
        self._queue_ns += time.perf_counter_ns() - begun_ns - done.infer_ns
        self._batch_size = max(self._batch_size, done.batch_size)
        return done.output

    def timing(self) -> Timing:
        """Returns where the time went until now."""
        total_ns = time.perf_counter_ns() - self._begun_ns
        return Timing(
            queue_ns=self._queue_ns,
            decode_ns=self._decode_ns,
            infer_ns=self._infer_ns,
            encode_ns=total_ns - self._queue_ns - self._decode_ns - self._infer_ns,
            total_ns=total_ns,
            batch_size=self._batch_size,
        )
