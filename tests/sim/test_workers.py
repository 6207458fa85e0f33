"""Worker processes, without the rules of sessions."""

import asyncio
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import replace
from functools import reduce
from operator import and_, or_
from pathlib import Path

import numpy as np
import psutil
import pytest
from tests.child_processes import children_running, stop

from freerein.errors import (
    FailedPrecondition,
    Internal,
    InvalidInput,
    ServiceError,
    SessionNotFound,
    TooLarge,
    WorkerLost,
)
from freerein.fork_server import StartChild
from freerein.types.common import Error, error_from
from freerein.types.sim import (
    CloseSessionRequest,
    CloseSessionResponse,
    CreateSessionRequest,
    CreateSessionResponse,
    DemonstrateRequest,
    DemonstrateResponse,
    ListTasksRequest,
    ListTasksResponse,
    ResetRequest,
    ResetResponse,
    SnapshotResponse,
    StepRequest,
    StepResponse,
)
from freerein_sim.workers import demonstrations, protocol
from freerein_sim.workers.handler import RequestHandler
from freerein_sim.workers.pool import WorkerPool
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.workers.worker import Connection, Worker
from freerein_sim.worlds import blocks, grid
from freerein_sim.worlds.grid import GridWorld
from freerein_sim.worlds.world import (
    Action,
    GroundTruth,
    LabelledAction,
    ScriptedPolicy,
    StepResult,
    TaskDefinition,
    World,
)

TASKS = {task.name: task for task in (*grid.TASKS, *blocks.TASKS)}
ORPHANED = """
import asyncio, sys
from freerein_sim.workers.pool import WorkerPool

async def main():
    await WorkerPool(workers=1).start()
    print("ready", flush=True)
    await asyncio.Event().wait()

asyncio.run(main())
"""

StartPool = Callable[..., Awaitable[WorkerPool]]


class Faulty(GridWorld):
    """A world with a bug."""

    def step(self, action: Action) -> StepResult:
        raise ZeroDivisionError


class Unsendable(GridWorld):
    """A world whose truth fits no message, once stepped."""

    def step(self, action: Action) -> StepResult:
        self.truth = lambda: GroundTruth(np.array([None]), 0.0, success=False)
        return super().step(action)


class Unclosable(Faulty):
    """A world with two bugs."""

    def close(self) -> None:
        raise ZeroDivisionError


class Idle:
    """Somebody who does nothing."""

    def act(self) -> LabelledAction | None:
        return None

    def succeeded(self) -> bool:
        return False


class Hopeless(GridWorld):
    """A world whose expert never succeeds."""

    def expert(self, skills: object, rng: np.random.Generator) -> ScriptedPolicy:
        return Idle()


@pytest.fixture
async def start_pool(fork_worker: StartChild) -> AsyncIterator[StartPool]:
    """A function that starts a pool, closed with the test."""
    pools: list[WorkerPool] = []

    async def start(**options: float) -> WorkerPool:
        pools.append(WorkerPool(fork_worker, **options))
        await pools[-1].start()
        return pools[-1]

    yield start
    for pool in pools:
        await pool.close()


def children() -> list[psutil.Process]:
    """Returns the worker processes of this process, which may have other children."""
    return children_running("freerein_sim.workers")


def open_files(pid: int) -> set[int]:
    return {int(each.name) for each in Path(f"/proc/{pid}/fd").iterdir()}


async def create(worker: Worker, task: str, *, num_envs: int, seed: int = 5) -> str:
    request = CreateSessionRequest(task, num_envs=num_envs, seed=seed, lease_s=60)
    return (await worker.call(request, CreateSessionResponse)).session


@pytest.mark.fault("M6")
async def test_a_worker_that_dies_fails_its_calls_and_is_replaced(start_pool: StartPool) -> None:
    pool = await start_pool(workers=2)
    one, other = await pool.place(1), await pool.place(1)
    sessions = {worker: await create(worker, "grid", num_envs=1) for worker in (one, other)}
    victim = next(child for child in children() if child.pid == one.pid)
    stop(victim)
    in_flight = asyncio.ensure_future(one.call(ResetRequest(sessions[one]), ResetResponse))
    await asyncio.sleep(0)

    victim.send_signal(signal.SIGSEGV)
    victim.resume()

    with pytest.raises(WorkerLost):
        await in_flight
    with pytest.raises(WorkerLost):
        await one.call(ListTasksRequest(), ListTasksResponse)
    assert (await other.call(ResetRequest(sessions[other]), ResetResponse)).frames == {}
    replacement = await pool.place(1)
    assert replacement not in (one, other)
    assert await create(replacement, "grid", num_envs=1)


@pytest.mark.fault("M6")
async def test_a_worker_that_hangs_is_killed(start_pool: StartPool) -> None:
    pool = await start_pool(workers=1, stuck_s=3.0)
    worker = await pool.place(1)
    stop(children()[0])

    with pytest.raises(WorkerLost):
        await worker.call(ListTasksRequest(), ListTasksResponse)

    await worker.wait_ended()
    assert worker.is_lost


@pytest.mark.fault("M6")
async def test_a_worker_hangs_when_it_is_silent_and_not_when_calls_wait_behind_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours, theirs = socket.socketpair()
    loop, passed_s = asyncio.get_running_loop(), 0.0
    _, connection = await loop.create_connection(Connection, sock=ours)
    begun_s = loop.time()
    monkeypatch.setattr(loop, "time", lambda: begun_s + passed_s)
    replies = [b"".join(protocol.encode(ListTasksResponse(()), call=1, number=i)) for i in (1, 2)]
    calls = [asyncio.create_task(connection.ask(ListTasksRequest(), silence_s=100)) for _ in range(3)]
    await asyncio.sleep(0)

    for call, reply in zip(calls[:2], replies, strict=True):
        passed_s += 99
        theirs.sendall(reply)
        await call
    passed_s += 99
    await asyncio.sleep(0)
    assert not calls[2].done()
    passed_s += 2

    with pytest.raises(TimeoutError):
        await calls[2]
    connection.close()
    theirs.close()


def test_a_worker_dies_with_its_service() -> None:
    service = subprocess.Popen([sys.executable, "-c", ORPHANED], stdout=subprocess.PIPE)
    assert service.stdout is not None
    assert service.stdout.readline() == b"ready\n"
    (worker,) = psutil.Process(service.pid).children()

    service.kill()

    worker.wait(60)
    service.wait()
    service.stdout.close()


async def test_a_worker_has_one_thread_and_no_socket_but_its_own(start_pool: StartPool) -> None:
    await start_pool(workers=2)

    for child in children():
        assert child.num_threads() == 1
        assert len(open_files(child.pid) - {0, 1, 2}) == 1


async def test_sessions_are_placed_on_the_least_loaded_worker(start_pool: StartPool) -> None:
    pool = await start_pool(workers=2)

    crowded = await pool.place(5)
    quiet = await pool.place(1)

    assert quiet is not crowded
    assert await pool.place(3) is quiet
    assert await pool.place(2) is quiet
    assert await pool.place(1) is crowded


async def test_a_caller_that_goes_away_leaves_the_others_their_replies(start_pool: StartPool) -> None:
    pool = await start_pool(workers=1)
    worker = await pool.place(1)
    calls = [asyncio.create_task(worker.call(ListTasksRequest(), ListTasksResponse)) for _ in range(3)]
    await asyncio.sleep(0)

    calls[1].cancel()

    assert await calls[0] == await calls[2]
    assert calls[1].cancelled()


async def test_a_demonstration_that_nobody_waits_for_any_more_is_not_made(start_pool: StartPool) -> None:
    pool = await start_pool(workers=1)
    others, request = children(), DemonstrateRequest("grid", "random")
    await pool.demonstrate(request)
    (demonstrator,) = (child for child in children() if child not in others)
    before_s = demonstrator.cpu_times().user
    for _ in range(300):
        await pool.demonstrate(request)
    all_s = demonstrator.cpu_times().user - before_s
    stop(demonstrator)
    calls = [asyncio.create_task(pool.demonstrate(request)) for _ in range(300)]
    await asyncio.sleep(0)

    for call in calls[:-1]:
        call.cancel()
    await asyncio.wait(calls[:-1])
    before_s = demonstrator.cpu_times().user
    demonstrator.resume()

    assert (await calls[-1]).index == 0
    assert demonstrator.cpu_times().user - before_s < all_s / 2  # two were made: the one begun and the one awaited


async def test_refusals_cross_the_socket_whole(start_pool: StartPool) -> None:
    pool = await start_pool(workers=1)
    worker = await pool.place(1)
    session = await create(worker, "grid", num_envs=2)
    envs = VectorEnv(TASKS["grid"], num_envs=2, seed=5)
    actions = np.full((2, 1), 9)
    await worker.call(ResetRequest(session), ResetResponse)
    envs.reset()

    with pytest.raises(InvalidInput) as theirs:
        await worker.call(StepRequest(session, 1, actions), StepResponse)

    with pytest.raises(InvalidInput) as ours:
        envs.step(actions)
    assert vars(theirs.value) == vars(ours.value)


async def test_a_message_that_announces_too_much_ends_the_connection_unread() -> None:
    ours, theirs = socket.socketpair()
    _, connection = await asyncio.get_running_loop().create_connection(Connection, sock=ours)
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: None)  # asyncio tells it
    asking = asyncio.ensure_future(connection.ask(ListTasksRequest(), silence_s=60))
    await asyncio.sleep(0)

    theirs.sendall(struct.pack("<IBQ", protocol.MAX_MESSAGE_BYTES + 1, 1, 1))

    with pytest.raises(WorkerLost):
        await asking
    theirs.close()


def test_a_message_over_the_limit_is_not_sent() -> None:
    with pytest.raises(TooLarge, match="at most 68157440 bytes"):
        protocol.encode(SnapshotResponse(bytes(protocol.MAX_MESSAGE_BYTES + 1)), call=1, number=1)


@pytest.mark.fault("F1")
@pytest.mark.parametrize("faulty", [Faulty, Unsendable, Unclosable])
def test_a_bug_in_a_world_ends_its_session_and_no_other(faulty: type[GridWorld]) -> None:
    handler = RequestHandler(
        {
            "grid": TASKS["grid"],
            "faulty": TaskDefinition("faulty", "grid", "", grid.SPEC, lambda: faulty(indicator=True)),
        }
    )
    request = CreateSessionRequest("grid", num_envs=1, seed=0, privileged=True)
    good = handler.handle(request).session
    bad = handler.handle(replace(request, task="faulty")).session
    up = np.zeros((1, 1), np.int64)
    for session in (good, bad):
        handler.handle(ResetRequest(session))

    refusal = answer(handler, StepRequest(bad, 1, up))
    assert isinstance(refusal, Internal)
    assert "its session has ended" in refusal.detail

    with pytest.raises(SessionNotFound):
        handler.handle(StepRequest(bad, 1, up))
    assert handler.handle(StepRequest(good, 1, up)).step_id == 1
    assert handler.handle(CloseSessionRequest(good)) == CloseSessionResponse()


@pytest.mark.fault("F1")
def test_a_bug_in_a_demonstration_is_told_as_that_and_its_world_is_made_anew() -> None:
    worlds: list[World] = []
    closed: list[World] = []

    class FaultyOnce(GridWorld):
        def step(self, action: Action) -> StepResult:
            if self is worlds[0]:
                raise ZeroDivisionError
            return super().step(action)

        def close(self) -> None:
            closed.append(self)

    def make() -> World:
        worlds.append(FaultyOnce(indicator=True))
        return worlds[-1]

    handler = RequestHandler({"faulty": TaskDefinition("faulty", "grid", "", grid.SPEC, make)})
    request = DemonstrateRequest("faulty", "expert")

    refusal = answer(handler, request)

    assert isinstance(refusal, Internal)
    assert "session" not in f"{refusal.detail} {refusal.hint}"
    assert closed == worlds
    assert answer(handler, request) is None


def answer(handler: RequestHandler, request: object) -> ServiceError | None:
    """Returns the refusal that a handler answers with over the socket, None for a response."""
    header, body = protocol.encode(request, call=protocol.CALLS.index(type(request)), number=1)
    header, body = handler.reply(protocol.decode_header(header), bytearray(body))
    refused = protocol.decode_header(header).call == protocol.REFUSED
    return error_from(protocol.decode(body, Error)) if refused else None


@pytest.mark.fault("C14")
def test_all_128_bits_of_a_session_id_are_random() -> None:
    handler, request = RequestHandler(TASKS), CreateSessionRequest("grid", num_envs=1, seed=0)

    ids = [int(handler.handle(request).session, 16) for _ in range(64)]

    assert reduce(or_, ids) == 2**128 - 1
    assert reduce(and_, ids) == 0


def test_what_ends_frees_its_worlds() -> None:
    closed: list[World] = []

    class Counted(GridWorld):
        def close(self) -> None:
            closed.append(self)

    handler = RequestHandler(
        {"counted": TaskDefinition("counted", "grid", "", grid.SPEC, lambda: Counted(indicator=True))}
    )
    request = CreateSessionRequest("counted", num_envs=2, seed=0)
    one, _ = handler.handle(request), handler.handle(request)
    handler.handle(DemonstrateRequest("counted", "expert"))

    handler.handle(CloseSessionRequest(one.session))
    assert len(closed) == 2
    handler.close()
    assert len(closed) == 5


def demonstrated(task: str, **request: object) -> list[DemonstrateResponse]:
    whole = DemonstrateRequest(task, **{"behaviour": "expert", "count": 4, "seed": 3, **request})
    world = TASKS[task].make()
    requests = [replace(whole, first=i) for i in range(whole.first, whole.count)]
    made = [demonstrations.make_demonstration(TASKS[task], world, request) for request in requests]
    world.close()
    return made


def test_any_part_of_the_demonstrations_can_be_made_again() -> None:
    whole, rest = demonstrated("grid"), demonstrated("grid", first=2)

    assert [each.index for each in rest] == [2, 3]
    for again, once in zip(rest, whole[2:], strict=True):
        assert again.trajectory.skills == once.trajectory.skills
        assert again.trajectory.actions.tobytes() == once.trajectory.actions.tobytes()
        for camera, frames in once.trajectory.frames.items():
            assert again.trajectory.frames[camera].tobytes() == frames.tobytes()


def test_skills_are_the_sorted_set_of_those_executed_and_labels_say_when() -> None:
    for each in demonstrated("grid", count=20, min_skills=2, max_skills=3, privileged=True):
        executed = {TASKS["grid"].spec.skills[label] for label in each.labels}
        assert each.trajectory.skills == tuple(sorted(executed))
        assert 2 <= len(executed) <= 3
        assert len(each.labels) == len(each.trajectory.actions) == len(each.trajectory.frames["top"])


def test_every_number_of_skills_and_every_order_occurs() -> None:
    made = demonstrated("grid", count=60, skills=("pick-red", "pick-green"), privileged=True)

    orders = {tuple(dict.fromkeys(each.labels.tolist())) for each in made}
    assert orders == {(0,), (1,), (0, 1), (1, 0)}


def test_labels_are_for_the_privileged() -> None:
    assert [each.labels.size for each in demonstrated("grid")] == [0] * 4


def test_random_actions_have_no_skills_and_as_many_cameras_as_asked_for() -> None:
    (made,) = demonstrated("blocks", behaviour="random", count=1, cameras=("left", "tilt"), height=32, width=24)

    assert made.trajectory.skills == ()
    assert {frames.shape[1:] for frames in made.trajectory.frames.values()} == {(32, 24, 3)}
    assert list(made.trajectory.frames) == ["left", "tilt"]


@pytest.mark.parametrize(
    "request_",
    [
        {"skills": ("pick-nothing",)},
        {"skills": ("pick-red", "pick-red")},
        {"min_skills": 6},
        {"min_skills": 3, "max_skills": 2},
        {"max_skills": 3, "skills": ("pick-red",)},
        {"behaviour": "random", "skills": ("pick-red",)},
        {"cameras": ("nowhere",)},
        {"height": 1000},
    ],
)
def test_a_demonstration_that_cannot_be_is_refused(request_: dict[str, object]) -> None:
    with pytest.raises(ServiceError) as refusal:
        demonstrated("grid", **request_)
    assert isinstance(refusal.value, InvalidInput)
    assert refusal.value.field


def test_an_expert_that_fails_again_and_again_is_refused_not_recorded() -> None:
    with pytest.raises(FailedPrecondition, match="within 10 tries"):
        demonstrations.make_demonstration(TASKS["grid"], Hopeless(indicator=True), DemonstrateRequest("grid", "expert"))


@pytest.mark.fault("M6")
async def test_a_worker_that_hangs_while_it_starts_does_not_hold_up_the_end(fork_worker: StartChild) -> None:
    pool = WorkerPool(fork_worker, workers=1, stuck_s=600.0)
    starting = asyncio.create_task(pool.start())
    while not children():  # noqa: ASYNC110  # no event tells of a process
        await asyncio.sleep(0)
    stop(children()[0])
    begun = time.monotonic()

    starting.cancel()
    await pool.close()

    assert time.monotonic() - begun < 30  # a worker may take 60 s to start
    assert starting.cancelled()
    assert children() == []
