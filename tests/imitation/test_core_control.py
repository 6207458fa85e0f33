"""Control streams: the Hello, the order of replies, dropped observations, and what ends a stream."""

import asyncio
import gc
import itertools
import threading
import time
import weakref
from collections.abc import AsyncIterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.faults import control_robot as robots
from tests.faults import faulty_policy as policies

from freerein.errors import FailedPrecondition, InvalidInput, MalformedRequest, ServiceError
from freerein.serving.methods import InvalidMessage
from freerein.types.common import ActionSpec, Camera, Goal, Image, Observation
from freerein.types.imitation import ControlRequest

LAST_NS = 2**64 - 1


@pytest.fixture
def open_stream(core: Any) -> Any:
    return lambda: robots.Stream(core.control.control)


@pytest.fixture
def open_held_stream(core: Any) -> Any:
    """A function that opens a stream whose first observation is in the model until an event is set.

    It takes the Hello, and returns the stream, the answer to come and the event.
    """

    async def open_held(hello: ControlRequest) -> tuple[Any, Any, threading.Event]:
        is_held, gate = threading.Event(), threading.Event()
        policy = policies.FaultyPolicy(policies.SEEDS[0], hold=lambda: is_held.set() or gate.wait(60))
        stream = robots.Stream(core.around(policy).control)
        await stream.ask(hello)
        answer = asyncio.create_task(stream.ask(robots.seen(0, fault="held")))
        assert await asyncio.to_thread(is_held.wait, 60)
        return stream, answer, gate

    return open_held


async def test_a_hello_is_answered_by_the_spec_and_observations_by_chunks(open_stream: Any) -> None:
    stream, oracle = open_stream(), await robots.Oracle.of(policies.FaultyPolicy(policies.SEEDS[0]), 3, 5)
    assert (await stream.ask(robots.hello(3, 5))).spec.cameras == robots.CAMERAS
    for seq, brightness in enumerate((1, 3, 4, 5, 6)):
        request = robots.seen(seq, brightness, did=(0.25, -0.5))
        await oracle.check(request, await stream.ask(request))
    assert await stream.rest() == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"cameras": ()}, "cameras: (front 4 x 4 x 3) for the model, () for the robot"),
        ({"cameras": (Camera("front", 8, 4, 3),)}, "(front 8 x 4 x 3) for the robot"),
        ({"cameras": (Camera("top", 4, 4, 3),)}, "(top 4 x 4 x 3) for the robot"),
        ({"control_dt_s": 0.05}, "control_dt_s: 0.02 for the model, 0.05 for the robot"),
        ({"action": ActionSpec(3, 0, ("x", "y", "z"), "m", (0.01,) * 3)}, "action.size: 2 for the model, 3 for the"),
        ({"action": ActionSpec(2, 5, ("x", "y"), "m", (0.01, 0.01))}, "action.choices: 0 for the model, 5 for"),
        ({"action": ActionSpec(2, 0, ("y", "x"), "m", (0.01, 0.01))}, "(x, y) for the model, (y, x) for the robot"),
        ({"action": ActionSpec(2, 0, ("x", "y"), "", (0.01, 0.01))}, "action.unit: m for the model, none for the"),
        ({"action": ActionSpec(2, 0, ("x", "y"), "m", (0.01, 0.02))}, "action.scale"),
        ({"action": ActionSpec(2, 0, ("x" * 9999, "\n"), "m", (0.01, 0.01))}, "(9999 characters, 1 characters)"),
    ],
)
async def test_a_robot_that_means_something_else_is_refused_with_both_said(
    open_stream: Any, change: dict[str, Any], said: str
) -> None:
    with pytest.raises(FailedPrecondition) as error:
        await open_stream().ask(robots.hello(**change))
    assert said in error.value.detail
    assert error.value.field == "hello"


async def test_a_robot_lists_several_cameras_in_any_order(core: Any) -> None:
    cameras = (*robots.CAMERAS, Camera("wrist", 2, 3, 1))
    wrist = Image("raw_gray8", 2, 3, bytes(6), "wrist")
    policy = policies.FaultyPolicy(policies.SEEDS[0])
    policy.spec = replace(policy.spec, cameras=cameras)
    stream = robots.Stream(core.around(policy).control)
    hello = robots.hello(cameras=cameras[::-1], goal=Goal((robots.picture(3), wrist)))
    assert (await stream.ask(hello)).spec.cameras == cameras
    assert (await stream.ask(robots.seen(0))).error.field == "observation.images"
    both = replace(robots.seen(1).observed, observation=Observation((wrist, robots.picture(3))))
    assert (await stream.ask(ControlRequest(observed=both))).chunk.goal_reached


async def test_what_is_meant_alike_is_agreed(open_stream: Any) -> None:
    alike = ActionSpec(2, 0, ("x", "y"), "m", (float(np.float32(0.01)),) * 2)
    request = robots.hello(action=alike, cameras=(Camera("", 4, 4, 3),))
    assert (await open_stream().ask(request)).spec is not None


@pytest.mark.parametrize("valid_for_s", [-1.0, 61.0])
async def test_actions_are_valid_for_a_while_and_not_for_ever(open_stream: Any, valid_for_s: float) -> None:
    with pytest.raises(InvalidInput):
        await open_stream().ask(robots.hello(valid_for_s=valid_for_s))


@pytest.mark.parametrize(
    ("valid_for_s", "seen_ns", "until_ns"),
    [(0.0, 5, 5 + 10_000_000_000), (30.5, 7, 7 + 30_500_000_000), (30.5, LAST_NS - 1, LAST_NS)],
)
async def test_a_chunk_says_until_when_it_is_valid_on_the_robots_clock(
    core: Any, valid_for_s: float, seen_ns: int, until_ns: int
) -> None:
    policy = policies.FaultyPolicy(policies.SEEDS[0])
    policy.spec = replace(policy.spec, control_dt_s=2.0)
    stream = robots.Stream(core.around(policy).control)
    await stream.ask(robots.hello(control_dt_s=2.0, valid_for_s=valid_for_s))
    observed = replace(robots.seen(1).observed, observation_time_ns=seen_ns)
    chunk = (await stream.ask(ControlRequest(observed=observed))).chunk
    assert (chunk.observation_time_ns, chunk.valid_until_ns) == (seen_ns, until_ns)


# --- the order of messages

HELLO, NEXT, REPEATED, BACKWARDS, UNREADABLE, NEITHER, BOTH, NO_MESSAGE = range(8)
SYMBOLS = (HELLO, NEXT, REPEATED, BACKWARDS, UNREADABLE, NEITHER, BOTH, NO_MESSAGE)


def message(symbol: int, last: int) -> Any:
    said = {
        HELLO: robots.hello(),
        NEXT: robots.seen(last + 3),
        REPEATED: robots.seen(last),
        BACKWARDS: robots.seen(last - 1),
        UNREADABLE: InvalidMessage(InvalidInput("It lies."), seq=last + 3),
        NEITHER: ControlRequest(),
        BOTH: ControlRequest(robots.hello().hello, robots.seen(last + 3).observed),
        NO_MESSAGE: InvalidMessage(MalformedRequest("No message.")),
    }
    return said[symbol]


@pytest.mark.fault("I4")
async def test_every_short_order_of_messages_comes_to_what_the_protocol_says(open_stream: Any) -> None:
    for symbols in itertools.chain.from_iterable(itertools.product(SYMBOLS, repeat=n) for n in (1, 2)):
        await follow(open_stream(), symbols)
    for symbols in itertools.product((NEXT, REPEATED, BACKWARDS, UNREADABLE, HELLO), repeat=3):
        await follow(open_stream(), (HELLO, *symbols))


async def follow(stream: Any, symbols: tuple[int, ...]) -> None:
    greeted, last = False, 10
    for symbol in symbols:
        request = message(symbol, last)
        ends = {NEITHER: InvalidInput, BOTH: InvalidInput, NO_MESSAGE: MalformedRequest}.get(symbol)
        if greeted == (symbol == HELLO) and ends is None:
            ends = FailedPrecondition
        if ends is not None:
            with pytest.raises(ends):
                await stream.ask(request)
            return
        reply = await stream.ask(request)
        if symbol == HELLO:
            greeted = True
            assert reply.spec is not None
            await stream.ask(robots.seen(last))
        elif symbol == NEXT:
            assert (reply.seq, reply.chunk is not None) == (last + 3, True)
        else:
            assert reply.error.code == "invalid_input"
            assert reply.seq == {REPEATED: last, BACKWARDS: last - 1, UNREADABLE: last + 3}[symbol]
        last = last + 3 if symbol in (NEXT, UNREADABLE) else last
    assert await stream.rest() == []


async def test_a_refused_observation_leaves_the_memory_as_it_was(open_stream: Any) -> None:
    stream, oracle = open_stream(), await robots.Oracle.of(policies.FaultyPolicy(policies.SEEDS[0]), 3)
    await stream.ask(robots.hello(3))
    for seq in range(0, 12, 4):
        good = robots.seen(seq, seq + 10, did=(0.5, 0.5))
        await oracle.check(good, await stream.ask(good))
        bad = replace(robots.seen(seq + 1).observed, observation=Observation())
        assert (await stream.ask(ControlRequest(observed=bad))).error.field == "observation.images"
        assert (await stream.ask(robots.seen(seq + 2, fault="raises"))).error.code == "model_fault"
        assert (await stream.ask(robots.seen(seq + 3, fault="nan"))).error.code == "output_not_finite"


# --- the newest observation wins


async def test_while_the_model_works_the_newest_observation_waits_and_the_rest_are_counted(
    open_held_stream: Any,
) -> None:
    stream, first, gate = await open_held_stream(robots.hello())
    stream.say(*(robots.seen(seq) for seq in range(1, 6)), robots.seen(5), robots.seen(6))
    await robots.turns()
    gate.set()
    replies = [await first, *await stream.rest()]
    assert [reply.seq for reply in replies] == [0, 5, 6]
    assert replies[1].error is not None
    assert [replies[i].chunk.dropped for i in (0, 2)] == [5, 5]


async def test_time_goes_on_for_those_that_were_overtaken(open_held_stream: Any) -> None:
    stream, first, gate = await open_held_stream(robots.hello(max_steps_per_goal=6))
    stream.say(*(robots.seen(seq, did=(0, 0)) for seq in range(1, 7)))
    await robots.turns()
    gate.set()
    replies = [await first, *await stream.rest()]
    assert [(reply.seq, reply.chunk.goal_abandoned) for reply in replies] == [(0, False), (6, True)]


@pytest.mark.parametrize("refused", ["raises", "nan", "empty", "unreadable"])
async def test_time_goes_on_for_those_that_were_refused(open_stream: Any, refused: str) -> None:
    stream = open_stream()
    await stream.ask(robots.hello(max_steps_per_goal=6))
    for seq, given_up in ((0, False), (2, False), (4, False), (6, True)):
        chunk = (await stream.ask(robots.seen(seq, did=(0, 0)))).chunk
        assert (chunk.goal_abandoned, len(chunk.actions) == 0) == (given_up, given_up)
        said = {
            "empty": ControlRequest(observed=replace(robots.seen(seq + 1).observed, observation=Observation())),
            "unreadable": InvalidMessage(InvalidInput("It lies."), seq=seq + 1),
        }
        assert (await stream.ask(said.get(refused) or robots.seen(seq + 1, fault=refused))).error is not None


async def test_time_goes_on_for_those_that_were_not_answered_in_time(core: Any) -> None:
    is_busy = threading.Event()

    def hold() -> None:
        is_busy.set()
        while b"freerein_queued_items 1.0" not in core.metrics.text():
            time.sleep(0.01)
        time.sleep(2.1)  # longer than what waits may

    service = core.around(policies.FaultyPolicy(policies.SEEDS[0], hold=hold))
    busy, late = robots.Stream(service.control), robots.Stream(service.control)
    await busy.ask(robots.hello())
    await late.ask(robots.hello(max_steps_per_goal=4, valid_for_s=2.0))
    assert (await late.ask(robots.seen(0))).chunk is not None
    working = asyncio.create_task(busy.ask(robots.seen(0, fault="held")))
    assert await asyncio.to_thread(is_busy.wait, 60)
    executed = replace(robots.seen(3).observed, executed_actions=np.zeros((3, 2), np.float32))
    assert (await late.ask(ControlRequest(observed=executed))).error.code == "deadline_exceeded"
    await working
    assert (await late.ask(robots.seen(4, did=(0, 0)))).chunk.goal_abandoned


async def test_refusals_wait_for_a_robot_that_does_not_listen_and_do_not_pile_up(core: Any) -> None:
    taken = 0

    async def requests() -> Any:
        nonlocal taken
        yield robots.hello()
        for _ in range(1000):
            taken += 1
            yield robots.seen(1)
            await asyncio.sleep(0)

    heard = core.control.control(requests())
    assert (await anext(heard)).spec is not None
    await robots.turns(1000)
    assert 8 < taken < 20
    assert sum([1 async for _ in heard]) == 1000


# --- ends


async def test_draining_answers_what_came_then_says_so_and_ends(core: Any, open_stream: Any) -> None:
    stream = open_stream()
    await stream.ask(robots.hello())
    stream.say(robots.seen(0, hundredths=5))
    await robots.turns()
    core.health.drain()
    assert (await stream.hear()).chunk is not None
    assert (await stream.hear()).draining.deadline_s == 5.0
    with pytest.raises(StopAsyncIteration):
        await stream.hear()


@pytest.mark.fault("I11")
async def test_a_stream_goes_on_where_another_one_stopped(open_stream: Any) -> None:
    oracle, state = await robots.Oracle.of(policies.FaultyPolicy(policies.SEEDS[0]), 3, 5), b""
    for first in (0, 10):
        stream = open_stream()
        await stream.ask(robots.hello(3, 5, state=state))
        for seq in range(first, first + 5):
            request = robots.seen(seq, seq, did=(0.1, 0.2))
            reply = await stream.ask(request)
            await oracle.check(request, reply)
            state = reply.chunk.state
        await stream.leave()


@pytest.mark.parametrize("before", [0, 1, 2])
async def test_a_bug_while_reading_is_raised_once_what_came_before_it_is_answered(core: Any, before: int) -> None:
    async def requests() -> Any:
        for request in (robots.hello(), robots.seen(1, hundredths=2))[:before]:
            yield request
        raise RuntimeError("a bug")

    heard = core.control.control(requests())
    for _ in range(before):
        assert (await anext(heard)).error is None
    with pytest.raises(RuntimeError, match="a bug"):
        await anext(heard)


async def test_one_who_leaves_leaves_nothing_behind(open_stream: Any) -> None:
    before = len(asyncio.all_tasks())
    stream = open_stream()
    await stream.ask(robots.hello())
    await stream.leave()
    assert len(asyncio.all_tasks()) == before


@pytest.mark.fault("I11")
@pytest.mark.fault("I18")
async def test_interleaved_streams_hear_what_each_would_hear_alone(open_stream: Any) -> None:
    async def run(robot: int) -> None:
        rng = np.random.default_rng(robot)
        goals = rng.integers(0, 8, 1 + robot % 3).tolist()
        stream, oracle = open_stream(), await robots.Oracle.of(policy, *goals)
        await stream.ask(robots.hello(*goals))
        for seq in range(10 + robot):
            request = robots.seen(seq, int(rng.integers(0, 8)), did=rng.uniform(-1, 1, 2), hundredths=robot % 2)
            await oracle.check(request, await stream.ask(request))
        assert await stream.rest() == []

    policy = policies.FaultyPolicy(policies.SEEDS[0])
    await asyncio.gather(*(run(robot) for robot in range(16)))


@pytest.mark.fault("G9")
async def test_a_stream_that_breaks_the_protocol_keeps_nothing_alive(core: Any) -> None:
    async def requests() -> AsyncIterator[ControlRequest]:
        yield robots.seen(1)

    async def ask() -> "weakref.ref[Exception]":
        try:
            await anext(core.control.control(requests()))
        except FailedPrecondition as error:
            return weakref.ref(error)
        raise AssertionError

    gc.collect()
    gc.disable()  # an error that holds its own stream would stay until the next collection
    try:
        error = await ask()
        await robots.turns()
        assert error() is None
    finally:
        gc.enable()


async def test_an_error_of_the_hello_ends_the_stream(open_stream: Any) -> None:
    for change in ({"state": b"x"}, {"goal": robots.goal()}):
        with pytest.raises(ServiceError):
            await open_stream().ask(robots.hello(**change))
