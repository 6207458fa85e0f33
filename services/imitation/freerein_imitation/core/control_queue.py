"""The queue of one control stream's messages: at most one pending observation, the newest, and errors in order.

A robot must not wait for actions for what it no longer observes, so a newer observation replaces the pending one.
"""

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass

from freerein.errors import FailedPrecondition, InvalidInput, ServiceError, must_be
from freerein.serving.methods import InvalidMessage
from freerein.types.imitation import ControlRequest, Hello, Observed
from freerein_imitation.core.inputs import elapsed_steps

_MAX_ENTRIES = 8

Requests = AsyncIterator[ControlRequest | InvalidMessage]


@dataclass(frozen=True, eq=False)
class PendingObservation:
    """An observation that waits for the model.

    Attributes:
        observed: The message.
        arrived_ns: Arrival, on the clock of `time.perf_counter_ns`.
        elapsed: Control steps since the observation taken from the queue before it.
    """

    observed: Observed
    arrived_ns: int
    elapsed: int


@dataclass(frozen=True, eq=False)
class RejectedMessage:
    """A message that is answered by an error."""

    seq: int
    error: ServiceError


QueueEntry = Hello | PendingObservation | RejectedMessage


class ControlQueue:
    """Messages of a stream that are not answered yet, in the order of `seq`.

    Attributes:
        dropped: Observations that a newer one replaced.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._entries: deque[QueueEntry] = deque()
        self._pending: PendingObservation | None = None
        self._has_hello = False
        self._unreadable_steps = 0  # control steps, one for each unreadable observation since the last readable one
        self._last_seq = -1
        self._closed = False
        self._filled = asyncio.Event()
        self._emptied = asyncio.Event()

    async def fill(self, requests: Requests) -> None:
        """Takes messages until there are no more or the queue is closed; then closes it.

        Raises:
            ServiceError: A message violates the protocol.
        """
        try:
            async for request in requests:
                if self._closed:
                    return
                self._add(request)
                self._filled.set()
                await asyncio.sleep(0)  # let the consumer go first: the model works while this continues to read
                while len(self._entries) > _MAX_ENTRIES:  # a robot that does not read replies must not fill memory
                    self._emptied.clear()
                    await self._emptied.wait()
        finally:
            self.close()

    async def next(self) -> QueueEntry | None:
        """Returns the next entry, waiting for it; None when the queue is closed and empty."""
        while not self._entries and not self._closed:
            self._filled.clear()
            await self._filled.wait()
        self._emptied.set()
        if not self._entries:
            return None
        entry = self._entries.popleft()
        if entry is self._pending:
            self._pending = None
        return entry

    def close(self) -> None:
        """Stops taking messages; what is in the queue is still answered."""
        self._closed = True
        self._filled.set()

    def _add(self, request: ControlRequest | InvalidMessage) -> None:
        if isinstance(request, InvalidMessage):
            self._add_invalid(request)
        elif request.hello is not None and request.observed is None:
            self._add_hello(request.hello)
        elif request.observed is not None and request.hello is None:
            self._add_observation(request.observed)
        else:
            raise InvalidInput(
                "A message must hold either a Hello or an observation; got both or none.",
                field="hello",
                hint="Set one of the two.",
            )

    def _add_hello(self, hello: Hello) -> None:
        if self._has_hello:
            raise FailedPrecondition(
                "A stream must have one Hello, its first message; got another.",
                field="hello",
                hint="Open another stream for another goal or model.",
            )
        self._has_hello = True
        self._entries.append(hello)

    def _add_observation(self, observed: Observed) -> None:
        self._check_hello()
        if not self._check_seq(observed.seq):
            return
        elapsed = self._unreadable_steps + elapsed_steps(observed.executed_actions)
        self._unreadable_steps = 0
        if (replaced := self._pending) is not None:
            self._entries.remove(replaced)
            self.dropped += 1
            elapsed += replaced.elapsed
        self._pending = PendingObservation(observed, time.perf_counter_ns(), elapsed)
        self._entries.append(self._pending)

    def _add_invalid(self, invalid: InvalidMessage) -> None:
        """Rejects an unreadable observation; any other unreadable message ends the stream."""
        if invalid.seq is None:
            raise invalid.error
        self._check_hello()
        if self._check_seq(invalid.seq):
            self._unreadable_steps += 1
            self._entries.append(RejectedMessage(invalid.seq, invalid.error))

    def _check_hello(self) -> None:
        if not self._has_hello:
            raise FailedPrecondition(
                "The first message of a stream must be a Hello; got an observation.",
                field="hello",
                hint="Send a Hello first: model, goal, cameras and actions.",
            )

    def _check_seq(self, seq: int) -> bool:
        """Tells whether a `seq` is above the last one; rejects the message when it is not."""
        if seq > self._last_seq:
            self._last_seq = seq
            return True
        hint = "Number observations from 0, each once; gaps are fine."
        error = must_be("`seq`", f"above {self._last_seq}", seq, field="observed.seq", hint=hint)
        self._entries.append(RejectedMessage(seq, error))
        return False
