"""`Control`: a robot's observations on one stream, chunks of actions back. The newest observation wins.

    messages -> _Inbox: refusals in order, and one observation, the newest -> batcher -> replies, in the order of seq

A robot cannot wait for answers to what it no longer sees, so that at most one observation waits while the model works
on the one before.
"""

import asyncio
import math
import time
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace

from freerein.api.imitation.v1 import imitation_pb2
from freerein.errors import FailedPrecondition, InvalidInput, ServiceError
from freerein.serving.health import Health
from freerein.serving.methods import InvalidMessage
from freerein.types.common import Camera, Draining, Error
from freerein.types.imitation import Chunk, ControlRequest, ControlResponse, GetSpecResponse, Hello, Observed
from freerein_imitation.core import Acting, Models, Pursuit, pursue, spec_of, timing
from freerein_imitation.observing import elapsed_steps

MAX_VALID_FOR_S = 60.0
_MOST_WAITING = 8
_SAME = 1e-3  # relative difference of times and scales that are meant to be the same
_LAST_NS = 2**64 - 1
_MOST_SHOWN = 16
_LONGEST_SHOWN = 32

Requests = AsyncIterator[ControlRequest | InvalidMessage]


class ControlStreams:
    """Serves control streams.

    Args:
        models: The policies.
        batcher: Runs `BatchActor.act_batch` on the model's thread.
        health: Tells when draining.
        drain_s: What streams are told they have left then, in seconds.
    """

    def __init__(self, models: Models, batcher: Acting, *, health: Health, drain_s: float) -> None:
        self._models = models
        self._batcher = batcher
        self._health = health
        self._drain_s = drain_s

    async def control(self, requests: Requests) -> AsyncIterator[ControlResponse]:
        """Yields the spec, then a chunk or an error for each observation that no newer one overtook.

        Args:
            requests: The messages; an `InvalidMessage` in place of one that could not be read.

        Raises:
            FailedPrecondition: The first message is no Hello, a later one is, or robot and model differ.
            ServiceError: As `Actor.act`, of what the Hello says.
        """
        inbox = _Inbox()
        reading = asyncio.ensure_future(inbox.read(requests))
        draining = asyncio.ensure_future(self._close_when_draining(inbox))
        stream: _Stream | None = None
        try:
            while (entry := await inbox.next()) is not None:
                if isinstance(entry, Hello):
                    stream = await self._open(entry)
                    yield ControlResponse(spec=stream.spec)
                elif isinstance(entry, _Refusal):
                    yield _error(entry.seq, entry.error)
                elif stream is not None:
                    yield await stream.answer(entry, inbox)
            if reading.done():
                reading.result()  # raises what ended it, a broken protocol or a bug
            if self._health.draining:
                yield ControlResponse(draining=Draining(self._drain_s))
        finally:
            reading.cancel()
            draining.cancel()
            await asyncio.gather(reading, draining, return_exceptions=True)

    async def _open(self, hello: Hello) -> "_Stream":
        model, policy = await self._models.resolve(hello.model)
        spec = spec_of(model, policy)
        _check_agreement(spec, hello)
        pursuit = await pursue(model, policy, hello.goal, max_steps=hello.max_steps_per_goal)
        return _Stream(spec, pursuit, hello, self._batcher)

    async def _close_when_draining(self, inbox: "_Inbox") -> None:
        await self._health.wait_for_drain()
        inbox.close()


@dataclass(frozen=True, eq=False)
class _Waiting:
    """An observation that waits for the model: when it came, and control steps since the one taken before it."""

    observed: Observed
    since_ns: int
    elapsed: int


@dataclass(frozen=True, eq=False)
class _Refusal:
    """A message that is answered by an error."""

    seq: int
    error: ServiceError


class _Inbox:
    """What came on a stream and is not answered yet: at most one observation, and refusals, in the order of seq.

    Attributes:
        dropped: Observations that a newer one overtook.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._entries: deque[Hello | _Waiting | _Refusal] = deque()
        self._waiting: _Waiting | None = None
        self._greeted = False
        self._unread = 0  # control steps, one for each observation since the last that could be read
        self._seq = -1
        self._closed = False
        self._filled = asyncio.Event()
        self._emptied = asyncio.Event()

    async def read(self, requests: Requests) -> None:
        """Takes messages until there are no more, or the inbox is closed; then closes it.

        Raises:
            ServiceError: A message broke the protocol.
        """
        try:
            async for request in requests:
                if self._closed:
                    return
                self._take(request)
                self._filled.set()
                await asyncio.sleep(0)  # who waits goes first: the model works while this reads on
                while len(self._entries) > _MOST_WAITING:  # refusals must not pile up before one who does not read
                    self._emptied.clear()
                    await self._emptied.wait()
        finally:
            self.close()

    async def next(self) -> "Hello | _Waiting | _Refusal | None":
        """Returns what is to be answered next, waiting for it; None when nothing will come any more."""
        while not self._entries and not self._closed:
            self._filled.clear()
            await self._filled.wait()
        self._emptied.set()
        if not self._entries:
            return None
        entry = self._entries.popleft()
        if entry is self._waiting:
            self._waiting = None
        return entry

    def close(self) -> None:
        """Takes nothing more; what is there will still be answered."""
        self._closed = True
        self._filled.set()

    def _take(self, request: ControlRequest | InvalidMessage) -> None:
        if isinstance(request, InvalidMessage):
            self._refuse(request)
        elif request.hello is not None and request.observed is None:
            self._greet(request.hello)
        elif request.observed is not None and request.hello is None:
            self._see(request.observed)
        else:
            raise InvalidInput(
                "A message must be exactly one of a Hello and an observation.",
                field="hello",
                hint="Set one of the two.",
            )

    def _greet(self, hello: Hello) -> None:
        if self._greeted:
            raise FailedPrecondition(
                "A stream must have one Hello, its first message; got another.",
                field="hello",
                hint="Open another stream for another goal or model.",
            )
        self._greeted = True
        self._entries.append(hello)

    def _see(self, observed: Observed) -> None:
        self._check_greeted()
        if not self._next_seq(observed.seq):
            return
        waiting, elapsed = self._waiting, self._unread + elapsed_steps(observed.executed_actions)
        self._unread = 0
        if waiting is not None:
            self._entries.remove(waiting)
            self.dropped += 1
            elapsed += waiting.elapsed
        self._waiting = _Waiting(observed, time.perf_counter_ns(), elapsed)
        self._entries.append(self._waiting)

    def _refuse(self, unreadable: InvalidMessage) -> None:
        """Answers an observation that cannot be read by an error; whatever else cannot be read ends the stream."""
        message = unreadable.message
        if not isinstance(message, imitation_pb2.ControlRequest) or not message.HasField("observed"):
            raise unreadable.error
        self._check_greeted()
        if self._next_seq(message.observed.seq):
            self._unread += 1
            self._entries.append(_Refusal(message.observed.seq, unreadable.error))

    def _check_greeted(self) -> None:
        if not self._greeted:
            raise FailedPrecondition(
                "The first message of a stream must be a Hello; got an observation.",
                field="hello",
                hint="Say Hello first: which model, cameras and actions, and what is to be achieved.",
            )

    def _next_seq(self, seq: int) -> bool:
        """Tells whether a number is above the one before; refuses it when it is not."""
        if seq > self._seq:
            self._seq = seq
            return True
        error = InvalidInput(
            f"`seq` must count up; got {seq} after {self._seq}.",
            field="observed.seq",
            hint="Number observations from 0, each once; gaps are fine.",
        )
        self._entries.append(_Refusal(seq, error))
        return False


class _Stream:
    """One robot's pursuit: the memory, and what its observations are answered.

    Attributes:
        spec: What robot and model agreed on.
    """

    def __init__(self, spec: GetSpecResponse, pursuit: Pursuit, hello: Hello, batcher: Acting) -> None:
        self.spec = spec
        self._pursuit = pursuit
        self._batcher = batcher
        self._memory = pursuit.recall(hello.state)
        self._begun = bool(hello.state)
        self._unanswered = 0  # control steps since the observation that is remembered, up to the last one refused
        self._valid_for_s = hello.valid_for_s or (spec.horizon + 2) * spec.control_dt_s

    async def answer(self, waiting: _Waiting, inbox: _Inbox) -> ControlResponse:
        """Returns the chunk for an observation, or the error that refuses it; then the memory is as it was."""
        observed, begun_ns = waiting.observed, time.perf_counter_ns()
        self._unanswered += waiting.elapsed
        elapsed = self._unanswered if self._begun else 0
        try:
            item = await self._pursuit.item(
                observed.observation, observed.executed_actions, self._memory, elapsed=elapsed
            )
            decode_ns = time.perf_counter_ns() - begun_ns
            done = await self._batcher.submit(item, key=self._pursuit.model, timeout_s=self._valid_for_s)
        except ServiceError as error:
            return _error(observed.seq, error)
        answer = done.output
        self._memory, self._begun, self._unanswered = answer.memory, True, 0
        chunk = Chunk(
            actions=answer.actions,
            goal_reached=answer.reached,
            goal_confidence=answer.confidence,
            goal_index=answer.memory.goal_index,
            goal_abandoned=answer.memory.abandoned,
            state=self._pursuit.state(answer.memory),
            observation_time_ns=observed.observation_time_ns,
            valid_until_ns=min(observed.observation_time_ns + round(self._valid_for_s * 1e9), _LAST_NS),
            dropped=inbox.dropped,
            timing=timing(waiting.since_ns, decode_ns, done),
        )
        return ControlResponse(seq=observed.seq, chunk=chunk)


def _error(seq: int, error: ServiceError) -> ControlResponse:
    told = Error(error.code, error.detail, error.field, error.hint, error.retry_after_s or 0.0)
    return ControlResponse(seq=seq, error=told)


def _check_agreement(spec: GetSpecResponse, hello: Hello) -> None:
    """Refuses a robot that sends, or takes an action to mean, something else than the model does."""
    if not 0.0 <= hello.valid_for_s <= MAX_VALID_FOR_S:
        raise InvalidInput(
            f"`valid_for_s` must be in [0, {MAX_VALID_FOR_S:g}] seconds; got {hello.valid_for_s:g}.",
            field="hello.valid_for_s",
            hint="Leave it 0 for two control steps beyond the chunk.",
        )
    ours, theirs = spec.action, hello.action
    compared = (
        ("cameras", spec.cameras, _named(hello.cameras, spec.cameras)),
        ("action.size", ours.size, theirs.size),
        ("action.choices", ours.choices, theirs.choices),
        ("action.names", ours.names, theirs.names),
        ("action.unit", ours.unit, theirs.unit),
        ("action.scale", ours.scale, theirs.scale),
        ("control_dt_s", spec.control_dt_s, hello.control_dt_s),
    )
    different = [
        f"{name}: {_shown(expected)} for the model, {_shown(got)} for the robot"
        for name, expected, got in compared
        if not _same(expected, got)
    ]
    if different:
        raise FailedPrecondition(
            f"Robot and model must agree; they do not: {'; '.join(different)}.",
            field="hello",
            hint="Use a model that was trained for this robot; GetSpec says what each was trained for.",
        )


def _named(cameras: tuple[Camera, ...], like: tuple[Camera, ...]) -> tuple[Camera, ...]:
    """Returns a robot's cameras; a single one without a name is the one that is meant."""
    if len(cameras) == len(like) == 1 and not cameras[0].name:
        return (replace(cameras[0], name=like[0].name),)
    return cameras


def _same(expected: object, got: object) -> bool:
    if isinstance(expected, tuple) and isinstance(got, tuple):
        return len(expected) == len(got) and all(map(_same, expected, got))
    if isinstance(expected, float) and isinstance(got, float):
        return math.isclose(expected, got, rel_tol=_SAME)
    return expected == got


def _shown(value: object) -> str:
    """Returns a value as an error may show it: what a robot calls things is shown when it is short and plain."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_shown, value[:_MOST_SHOWN]))}{', ...' if len(value) > _MOST_SHOWN else ''})"
    if isinstance(value, Camera):
        return f"{_shown(value.name)} {value.height} x {value.width} x {value.channels}"
    if isinstance(value, float):
        return f"{value:g}"
    text = str(value) or "none"
    return text if len(text) <= _LONGEST_SHOWN and text.isascii() and text.isprintable() else f"{len(text)} characters"
