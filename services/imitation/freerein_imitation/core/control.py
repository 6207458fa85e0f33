"""`ControlService`: observations of a robot on one stream, action chunks back."""

import asyncio
import math
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace

from freerein.errors import FailedPrecondition, ServiceError, must_be
from freerein.serving.health import Health
from freerein.types.common import Camera, Draining, error_message
from freerein.types.imitation import Chunk, ControlResponse, GetSpecResponse, Hello
from freerein_imitation.core.act import Policies
from freerein_imitation.core.act_context import ActContext, spec_response
from freerein_imitation.core.control_queue import ControlQueue, PendingObservation, RejectedMessage, Requests
from freerein_imitation.core.policy_session import PolicyBatcher, PolicySession

MAX_VALID_FOR_S = 60.0
_TOLERANCE = 1e-3  # relative, of times and scales
_LAST_NS = 2**64 - 1
_MOST_SHOWN = 16
_LONGEST_SHOWN = 32


@dataclass(frozen=True, eq=False)
class ControlService:
    """Answers `Control`.

    Attributes:
        models: The policies.
        batcher: Runs `PolicyRunner.run_batch` on the model's thread.
        health: Tells when the service drains.
        drain_s: Time to drain that streams are told, in seconds.
    """

    models: Policies
    batcher: PolicyBatcher
    health: Health
    drain_s: float

    async def control(self, requests: Requests) -> AsyncIterator[ControlResponse]:
        """Yields the spec, then a chunk or an error for each observation that no newer one replaced.

        Args:
            requests: Messages; an `InvalidMessage` in place of one that could not be parsed.

        Raises:
            FailedPrecondition: The first message is not a Hello, a later one is, or robot and model disagree.
            ServiceError: The Hello's model, goal or state is invalid, as in `ActService.act`.
        """
        queue = ControlQueue()
        reading = asyncio.ensure_future(queue.fill(requests))
        draining = asyncio.ensure_future(self._close_when_draining(queue))
        session: _ControlSession | None = None
        try:
            while (entry := await queue.next()) is not None:
                if isinstance(entry, Hello):
                    session = await self._open(entry)
                    yield ControlResponse(spec=session.spec)
                elif isinstance(entry, RejectedMessage):
                    yield _error(entry.seq, entry.error)
                elif session is not None:
                    yield await session.act(entry, queue)
            if reading.done():
                reading.result()  # raises a protocol violation, or a bug
            if self.health.draining:
                yield ControlResponse(draining=Draining(self.drain_s))
        finally:
            reading.cancel()
            draining.cancel()
            await asyncio.gather(reading, draining, return_exceptions=True)
            del reading  # its error holds this frame

    async def _open(self, hello: Hello) -> "_ControlSession":
        model, policy = await self.models.resolve(hello.model)
        spec = spec_response(model, policy.spec)
        _check_agreement(spec, hello)
        limit, resize = hello.max_steps_per_goal, hello.resize
        context = await ActContext.create(model, policy, hello.goal, max_steps=limit, resize=resize)
        return _ControlSession(spec, context, hello, self.batcher)

    async def _close_when_draining(self, queue: ControlQueue) -> None:
        await self.health.wait_for_drain()
        queue.close()


class _ControlSession:
    """One robot's stream after its Hello.

    Attributes:
        spec: The model's spec.
    """

    def __init__(self, spec: GetSpecResponse, context: ActContext, hello: Hello, batcher: PolicyBatcher) -> None:
        self.spec = spec
        self._valid_for_s = hello.valid_for_s or (spec.horizon + 2) * spec.control_dt_s
        self._batcher = batcher
        self._model = context.model
        self._policy = PolicySession(context, state=hello.state)

    async def act(self, pending: PendingObservation, queue: ControlQueue) -> ControlResponse:
        """Returns the chunk for an observation, or its error, which leaves the policy state unchanged."""
        observed, decoding_ns = pending.observed, time.perf_counter_ns()
        try:
            parsed = await self._policy.parse(observed.observation, observed.executed_actions, elapsed=pending.elapsed)
            done = await self._batcher.submit(parsed, key=self._model, timeout_s=self._valid_for_s)
        except ServiceError as error:
            return _error(observed.seq, error)
        chunk = Chunk(
            **self._policy.answer(done, arrived_ns=pending.arrived_ns, decoding_ns=decoding_ns),
            state=self._policy.state,
            observation_time_ns=observed.observation_time_ns,
            valid_until_ns=min(observed.observation_time_ns + round(self._valid_for_s * 1e9), _LAST_NS),
            dropped=queue.dropped,
        )
        return ControlResponse(seq=observed.seq, chunk=chunk)


def _error(seq: int, error: ServiceError) -> ControlResponse:
    return ControlResponse(seq=seq, error=error_message(error))


def _check_agreement(spec: GetSpecResponse, hello: Hello) -> None:
    """Checks that robot and model have the same cameras, actions and control rate."""
    if not 0.0 <= hello.valid_for_s <= MAX_VALID_FOR_S:
        rule = f"in [0, {MAX_VALID_FOR_S:g}] seconds"
        hint = "Leave it 0 for two control steps beyond the chunk."
        raise must_be("`valid_for_s`", rule, f"{hello.valid_for_s:g}", field="hello.valid_for_s", hint=hint)
    expected, got = spec.action, hello.action
    compared = (
        ("cameras", spec.cameras, _comparable(hello, spec.cameras)),
        ("action.size", expected.size, got.size),
        ("action.choices", expected.choices, got.choices),
        ("action.names", expected.names, got.names),
        ("action.unit", expected.unit, got.unit),
        ("action.scale", expected.scale, got.scale),
        ("action.absolute", expected.absolute, got.absolute),
        ("control_dt_s", spec.control_dt_s, hello.control_dt_s),
    )
    differences = [
        f"{name}: {_shown(model)} for the model, {_shown(robot)} for the robot"
        for name, model, robot in compared
        if not _equal(model, robot)
    ]
    if differences:
        raise FailedPrecondition(
            f"Robot and model must agree; they do not: {'; '.join(differences)}.",
            field="hello",
            hint="Use a model that was trained for this robot; GetSpec returns a model's spec.",
        )


def _comparable(hello: Hello, expected: tuple[Camera, ...]) -> tuple[Camera, ...]:
    """Returns a robot's cameras in the order of the model's, and in their sizes where images are resized."""
    cameras = _in_order(hello.cameras, expected)
    if hello.resize is None or len(cameras) != len(expected):
        return cameras
    pairs = zip(cameras, expected, strict=True)
    return tuple(replace(camera, height=model.height, width=model.width) for camera, model in pairs)


def _in_order(cameras: tuple[Camera, ...], expected: tuple[Camera, ...]) -> tuple[Camera, ...]:
    """Returns a robot's cameras in the order of the model's; a single one without a name gets the model's."""
    if len(cameras) == len(expected) == 1 and not cameras[0].name:
        return (replace(cameras[0], name=expected[0].name),)
    order = {camera.name: place for place, camera in enumerate(expected)}
    return tuple(sorted(cameras, key=lambda camera: order.get(camera.name, len(order))))


def _equal(expected: object, got: object) -> bool:
    if isinstance(expected, tuple) and isinstance(got, tuple):
        return len(expected) == len(got) and all(map(_equal, expected, got))
    if isinstance(expected, float) and isinstance(got, float):
        return math.isclose(expected, got, rel_tol=_TOLERANCE)
    return expected == got


def _shown(value: object) -> str:
    """Returns a value for an error message; a robot's names are shown when short and printable."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_shown, value[:_MOST_SHOWN]))}{', ...' if len(value) > _MOST_SHOWN else ''})"
    if isinstance(value, Camera):
        return f"{_shown(value.name)} {value.height} x {value.width} x {value.channels}"
    if isinstance(value, float):
        return f"{value:g}"
    text = str(value) or "none"
    return text if len(text) <= _LONGEST_SHOWN and text.isascii() and text.isprintable() else f"{len(text)} characters"
