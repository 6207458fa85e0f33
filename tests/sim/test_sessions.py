"""The rules of sessions, over real worker processes."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, replace

import numpy as np
import psutil
import pytest
import pytest_asyncio
from tests.child_processes import children_running, stop

from freerein.errors import (
    AlreadyExists,
    FailedPrecondition,
    InvalidInput,
    NotFound,
    Overloaded,
    ServiceError,
    SessionNotFound,
    StepOutOfOrder,
    Unavailable,
    WorkerLost,
)
from freerein.fork_server import StartChild
from freerein.types.sim import (
    CheckRequest,
    CloseSessionRequest,
    CloseSessionResponse,
    CreateSessionRequest,
    DemonstrateRequest,
    ExpertActionsRequest,
    ListTasksRequest,
    RenderRequest,
    ResetRequest,
    RestoreRequest,
    SnapshotRequest,
    SnapshotResponse,
    StepRequest,
    StepResponse,
)
from freerein_sim.core import SimCore
from freerein_sim.workers import protocol
from freerein_sim.workers.pool import WorkerPool
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds import grid

pytestmark = pytest.mark.asyncio(loop_scope="module")

GRID = next(task for task in grid.TASKS if task.name == "grid")
ONE = CreateSessionRequest("grid", seed=1)
UP, DOWN = np.zeros((1, 1), np.int64), np.ones((1, 1), np.int64)
TOP = ("top",)
Workers = list[psutil.Process]
StartSessions = Callable[..., Awaitable[tuple[SimCore, Workers]]]


@dataclass
class Clock:
    """A clock that is set by hand."""

    now_s: float = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


class SharedPool(WorkerPool):
    """A pool of one worker that outlives its services."""

    async def close(self) -> None:
        """Does nothing: the fixture stops the worker."""

    async def end(self) -> None:
        await super().close()


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def shared(fork_worker: StartChild) -> AsyncIterator[tuple[SharedPool, Workers]]:
    """The pool of tests that harm no worker, and its worker."""
    others, pool = children(), SharedPool(fork_worker, workers=1)
    await pool.start()
    yield pool, [child for child in children() if child not in others]
    await pool.end()


@pytest_asyncio.fixture(loop_scope="module")
async def start(
    clock: Clock, shared: tuple[SharedPool, Workers], fork_worker: StartChild
) -> AsyncIterator[StartSessions]:
    """A function that starts sessions of the test's own, closed with it, and returns their workers too.

    Their workers are shared unless the test says how many, or which pool.
    """
    started: list[SimCore] = []

    async def start_sessions(
        *, workers: int = 0, max_sessions: int = 64, max_envs: int = 512, pool: WorkerPool | None = None
    ) -> tuple[SimCore, Workers]:
        is_shared = not (pool or workers)
        others, pool = children(), shared[0] if is_shared else pool or WorkerPool(fork_worker, workers=workers)
        started.append(SimCore(pool, max_sessions=max_sessions, max_envs=max_envs, clock=clock))
        await started[-1].start()
        return started[-1], shared[1] if is_shared else [child for child in children() if child not in others]

    yield start_sessions
    for sessions in started:
        await sessions.close()


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def sessions(shared: tuple[SharedPool, Workers]) -> AsyncIterator[SimCore]:
    """The sessions that tests share which harm nobody."""
    core = SimCore(shared[0])
    await core.start()
    yield core
    await core.close()


async def begun(sessions: SimCore, request: CreateSessionRequest = ONE) -> str:
    session = (await sessions.create_session(request)).session
    await sessions.reset(ResetRequest(session))
    return session


async def snapshot(sessions: SimCore, session: str) -> bytes:
    return (await sessions.snapshot(SnapshotRequest(session))).snapshot


def children() -> Workers:
    """Returns the worker processes of this process, which may have other children."""
    return children_running("freerein_sim.workers")


def assert_same(one: StepResponse, other: StepResponse) -> None:
    assert one.step_id == other.step_id
    for name in ("reward", "terminated", "truncated", "diverged"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in ("frames", "final_frames"):
        assert {key: value.tobytes() for key, value in getattr(one, name).items()} == {
            key: value.tobytes() for key, value in getattr(other, name).items()
        }


async def test_a_session_says_what_it_is(sessions: SimCore) -> None:
    created = await sessions.create_session(CreateSessionRequest("grid"))
    longest = await sessions.create_session(replace(ONE, lease_s=3600.0))

    assert longest.lease_s == 3600.0
    assert len(bytes.fromhex(created.session)) == 16
    assert (created.num_envs, created.lease_s, created.task) == (1, 60.0, GRID.describe())
    assert created.task in (await sessions.list_tasks(ListTasksRequest())).tasks


async def test_the_seed_that_the_service_drew_makes_the_same_session_again(sessions: SimCore) -> None:
    drawn = await sessions.create_session(CreateSessionRequest("grid", num_envs=2))
    again = await sessions.create_session(CreateSessionRequest("grid", num_envs=2, seed=drawn.seed))

    first, second = [await sessions.reset(ResetRequest(each.session, cameras=TOP)) for each in (drawn, again)]

    assert first.frames["top"].tobytes() == second.frames["top"].tobytes()


@pytest.mark.parametrize("most", [3, GRID.spec.max_episode_steps + 2])
async def test_an_episode_may_be_shorter_or_longer_than_the_tasks_own(sessions: SimCore, most: int) -> None:
    created = await sessions.create_session(replace(ONE, max_episode_steps=most))
    assert created.task.max_episode_steps == most
    await sessions.reset(ResetRequest(created.session))
    truncated = [(await sessions.step(StepRequest(created.session, i, UP))).truncated[0] for i in range(1, most + 2)]
    assert np.flatnonzero(truncated).tolist() == [most - 1]


@pytest.mark.fault("M2")
@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"num_envs": 65}, InvalidInput),
        ({"lease_s": 3601.0}, InvalidInput),
        ({"lease_s": -1.0}, InvalidInput),
        ({"lease_s": float("nan")}, InvalidInput),
        ({"height": 257}, InvalidInput),
        ({"conditions": ("fog",)}, InvalidInput),
        ({"max_episode_steps": 10_001}, InvalidInput),
        ({"task": "nothing"}, NotFound),
    ],
)
async def test_a_session_out_of_bounds_is_refused(
    sessions: SimCore, change: dict[str, object], error: type[ServiceError]
) -> None:
    with pytest.raises(error) as refusal:
        await sessions.create_session(replace(ONE, **change))
    assert refusal.value.field == next(iter(change))


@pytest.mark.fault("M2")
@pytest.mark.fault("M8")
async def test_a_reply_that_could_outgrow_a_message_is_refused_before_the_step(sessions: SimCore) -> None:
    huge = CreateSessionRequest("blocks", num_envs=64, seed=0, height=256, width=256)
    session = await begun(sessions, huge)
    actions = np.zeros((64, 3), np.float32)

    with pytest.raises(InvalidInput, match="at most 66060288 bytes; these may have 75497472"):
        await sessions.step(StepRequest(session, 1, actions, ("front", "left", "tilt")))

    assert (await sessions.step(StepRequest(session, 1, actions))).step_id == 1
    await sessions.close_session(CloseSessionRequest(session))


async def test_a_reset_whose_reply_could_outgrow_a_message_is_refused(
    sessions: SimCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = await begun(sessions)
    monkeypatch.setattr(protocol, "MAX_FRAME_BYTES", 1)  # a world may have more cameras than ours, which fit

    with pytest.raises(InvalidInput, match="at most 1 bytes"):
        await sessions.reset(ResetRequest(session, cameras=TOP))


@pytest.mark.fault("M7")
@pytest.mark.parametrize("step_id", [1, 4])
async def test_a_step_out_of_turn_is_refused_and_says_which_was_expected(sessions: SimCore, step_id: int) -> None:
    session = await begun(sessions)
    for turn in (1, 2):
        await sessions.step(StepRequest(session, turn, UP))

    with pytest.raises(StepOutOfOrder, match=f"must be 3, one more than the last; got {step_id}") as refusal:
        await sessions.step(StepRequest(session, step_id, UP))

    assert refusal.value.field == "step_id"
    assert (await sessions.step(StepRequest(session, 3, UP))).step_id == 3


@pytest.mark.fault("M13")
@pytest.mark.parametrize("change", [{"actions": DOWN}, {"cameras": TOP}, {"action_repeat": 2}])
async def test_the_last_step_repeated_with_something_else_is_refused(
    sessions: SimCore, change: dict[str, object]
) -> None:
    session = await begun(sessions)
    step = StepRequest(session, 1, UP)
    await sessions.step(step)

    with pytest.raises(StepOutOfOrder, match="with other actions, cameras or repeats") as refusal:
        await sessions.step(replace(step, **change))

    assert refusal.value.field == "step_id"


@pytest.mark.fault("M7")
async def test_steps_at_the_same_time_are_made_one_after_the_other(sessions: SimCore) -> None:
    session = await begun(sessions)
    before = await snapshot(sessions, session)

    replies = await asyncio.gather(*(sessions.step(StepRequest(session, i, DOWN, TOP)) for i in (1, 1, 2, 2, 3)))

    assert [reply.step_id for reply in replies] == [1, 1, 2, 2, 3]
    envs = VectorEnv(GRID, num_envs=1, seed=0)
    envs.restore(before)
    for reply in replies[::2]:
        assert_same(reply, envs.step(DOWN, TOP))


@pytest.mark.fault("M13")
async def test_a_step_whose_caller_goes_away_is_made_and_its_reply_kept(start: StartSessions) -> None:
    sessions, workers = await start()
    session = await begun(sessions)
    stop(workers[0])
    step = asyncio.create_task(sessions.step(StepRequest(session, 1, DOWN)))
    waiting = asyncio.create_task(sessions.step(StepRequest(session, 2, DOWN)))
    for _ in range(5):
        await asyncio.sleep(0)

    step.cancel()
    waiting.cancel()
    await asyncio.wait([step, waiting])
    workers[0].resume()

    assert step.cancelled()
    assert waiting.cancelled()
    assert (await sessions.step(StepRequest(session, 1, DOWN))).step_id == 1
    assert (await sessions.step(StepRequest(session, 2, UP))).step_id == 2  # the one that waited was never made


@pytest.mark.fault("M7")
async def test_a_key_makes_one_session_however_often_it_is_used(sessions: SimCore) -> None:
    request = replace(ONE, idempotency_key="mine", seed=None, conditions=("blur", "warm"))
    reordered = replace(request, conditions=("warm", "blur"))

    first, twin = await asyncio.gather(sessions.create_session(request), sessions.create_session(reordered))

    assert first == twin == await sessions.create_session(request)
    with pytest.raises(AlreadyExists, match="`idempotency_key`"):
        await sessions.create_session(replace(request, num_envs=2))
    await sessions.close_session(CloseSessionRequest(first.session))
    assert (await sessions.create_session(replace(request, num_envs=2))).session != first.session


@pytest.mark.fault("M7")
async def test_a_key_whose_session_could_not_be_made_can_be_used_again(sessions: SimCore) -> None:
    request = replace(ONE, idempotency_key="again")

    with pytest.raises(InvalidInput):
        await sessions.create_session(replace(request, height=40))  # the grid's frames are smaller

    assert await sessions.create_session(request)


@pytest.mark.fault("M7")
async def test_a_call_that_waits_while_the_session_ends_finds_it_gone(sessions: SimCore) -> None:
    session = await begun(sessions)
    step = StepRequest(session, 1, UP)
    await sessions.step(step)

    closed, late = await asyncio.gather(
        sessions.close_session(CloseSessionRequest(session)),
        sessions.step(step),
        return_exceptions=True,
    )

    assert closed == CloseSessionResponse()
    assert isinstance(late, SessionNotFound)


async def test_the_truth_is_for_the_privileged(sessions: SimCore) -> None:
    plain, privileged = await begun(sessions), await begun(sessions, replace(ONE, privileged=True))

    assert (await sessions.step(StepRequest(plain, 1, UP))).truth is None
    told = await sessions.step(StepRequest(privileged, 1, UP))
    assert told.truth is not None
    assert told.truth.state.shape == (1, len(GRID.spec.state_names))
    assert not told.reward.any()
    completed = CheckRequest(privileged, "completed/pick-red", told.truth.state[None])
    assert (await sessions.check(completed)).holds.tolist() == [[False]]
    assert (await sessions.expert_actions(ExpertActionsRequest(privileged))).finished.tolist() == [False]
    for call in (
        sessions.check(replace(completed, session=plain)),
        sessions.expert_actions(ExpertActionsRequest(plain)),
    ):
        with pytest.raises(FailedPrecondition, match="needs a privileged session") as refusal:
            await call
        assert refusal.value.field == "session"


@pytest.mark.fault("M10")
async def test_a_restored_session_has_no_last_step(sessions: SimCore) -> None:
    session = await begun(sessions)
    await sessions.step(StepRequest(session, 1, DOWN))
    await sessions.restore(RestoreRequest(session, await snapshot(sessions, session)))

    with pytest.raises(StepOutOfOrder, match="must be 2"):
        await sessions.step(StepRequest(session, 1, DOWN))


async def test_demonstrations_come_in_order_and_resume_where_they_were_left(sessions: SimCore) -> None:
    request = DemonstrateRequest("grid", "expert", count=6, seed=3)

    whole = [each async for each in sessions.demonstrate(request)]
    rest = [each async for each in sessions.demonstrate(replace(request, first=4))]

    assert [each.index for each in whole] == list(range(6))
    assert [each.trajectory.actions.tobytes() for each in rest] == [
        each.trajectory.actions.tobytes() for each in whole[4:]
    ]
    assert [each async for each in sessions.demonstrate(replace(request, first=6))] == []


async def test_a_demonstration_says_where_its_episode_terminated(sessions: SimCore) -> None:
    ended = await anext(sessions.demonstrate(DemonstrateRequest("grid", "expert", max_skills=1)))
    cut = await anext(sessions.demonstrate(DemonstrateRequest("grid", "random")))

    assert ended.trajectory.terminated.tolist() == [False] * (len(ended.trajectory.actions) - 1) + [True]
    assert cut.trajectory.terminated.tolist() == [False] * GRID.spec.max_episode_steps


async def test_demonstrations_are_made_when_asked_for_and_left_without_a_trace(sessions: SimCore) -> None:
    stream = sessions.demonstrate(DemonstrateRequest("grid", "random", count=100_000))
    await anext(stream)
    next_one = asyncio.ensure_future(anext(stream))
    await asyncio.sleep(0)

    next_one.cancel()
    await asyncio.wait([next_one])
    await stream.aclose()

    assert [each.index async for each in sessions.demonstrate(DemonstrateRequest("grid", "random"))] == [0]


async def test_no_session_waits_for_a_demonstration(start: StartSessions) -> None:
    sessions, _ = await start(workers=1)
    session, others = await begun(sessions), children()
    stream = sessions.demonstrate(DemonstrateRequest("grid", "expert", count=2))
    await anext(stream)
    (demonstrator,) = (child for child in children() if child not in others)
    stop(demonstrator)
    made = asyncio.ensure_future(anext(stream))

    for step_id in (1, 2):
        await sessions.step(StepRequest(session, step_id, UP))

    assert not made.done()
    demonstrator.resume()
    assert (await made).index == 1
    await stream.aclose()


@pytest.mark.fault("M2")
@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"count": 0}, InvalidInput),
        ({"count": 100_001}, InvalidInput),
        ({"first": 3}, InvalidInput),
        ({"height": 300}, InvalidInput),
        ({"skills": ("fly",)}, InvalidInput),
        ({"conditions": ("warm", "cool")}, InvalidInput),
        ({"task": "nothing"}, NotFound),
        ({"task": "blocks", "cameras": ("front", "left", "tilt"), "height": 256, "width": 256}, InvalidInput),
    ],
)
async def test_demonstrations_out_of_bounds_are_refused(
    sessions: SimCore, change: dict[str, object], error: type[ServiceError]
) -> None:
    with pytest.raises(error):
        await anext(sessions.demonstrate(replace(DemonstrateRequest("grid", "expert", count=2), **change)))


@pytest.mark.fault("M8")
async def test_a_session_that_nobody_touches_ends_with_its_lease(start: StartSessions, clock: Clock) -> None:
    sessions, _ = await start(max_sessions=1)
    session = await begun(sessions, replace(ONE, lease_s=10))
    clock.now_s += 9.9
    await sessions.step(StepRequest(session, 1, UP))  # renews it
    clock.now_s += 9.9
    sessions.reap()
    assert len(sessions) == 1

    clock.now_s += 10

    with pytest.raises(SessionNotFound, match="lease has ended"):
        await sessions.step(StepRequest(session, 2, UP))
    async with asyncio.timeout(60):
        while len(sessions):  # noqa: ASYNC110  the reaper runs by itself, and tells nobody
            await asyncio.sleep(0.05)
    assert await begun(sessions)


@pytest.mark.fault("M8")
async def test_a_lease_that_ends_during_a_call_begins_anew_at_its_end(start: StartSessions, clock: Clock) -> None:
    sessions, workers = await start()
    session = await begun(sessions, replace(ONE, lease_s=10))
    stop(workers[0])
    step = asyncio.create_task(sessions.step(StepRequest(session, 1, UP)))
    await asyncio.sleep(0)

    clock.now_s += 11
    sessions.reap()
    waiting = asyncio.create_task(sessions.render(RenderRequest(session)))
    workers[0].resume()

    assert (await step).step_id == 1
    assert await waiting
    clock.now_s += 9.9
    assert (await sessions.step(StepRequest(session, 2, UP))).step_id == 2


@pytest.mark.fault("M8")
@pytest.mark.parametrize(
    ("limit", "num_envs", "said"),
    [({"max_sessions": 2}, 1, "At most 2 sessions"), ({"max_envs": 8}, 4, "FREEREIN_SIM_ENVS sets the limit")],
)
async def test_no_more_sessions_and_environments_are_open_than_may_be(
    start: StartSessions, limit: dict[str, int], num_envs: int, said: str
) -> None:
    sessions, _ = await start(**limit)
    request = replace(ONE, num_envs=num_envs)

    attempts = await asyncio.gather(*(sessions.create_session(request) for _ in range(5)), return_exceptions=True)

    refused = [attempt for attempt in attempts if isinstance(attempt, Overloaded)]
    assert len(refused) == 3
    assert all(error.retry_after_s and said in f"{error.detail} {error.hint}" for error in refused)
    assert len(sessions) == 2
    await sessions.close_session(CloseSessionRequest(attempts[0].session))
    assert await sessions.create_session(request)


@pytest.mark.fault("M8")
async def test_a_closed_session_leaves_its_memory(start: StartSessions) -> None:
    sessions, (worker,) = await start(workers=1)
    created = await sessions.create_session(CreateSessionRequest("tabletop", num_envs=8, seed=1))
    await sessions.reset(ResetRequest(created.session, cameras=("front",)))
    open_bytes = worker.memory_info().rss

    await sessions.close_session(CloseSessionRequest(created.session))

    assert worker.memory_info().rss < open_bytes - 8 * 4 * 2**20


@pytest.mark.fault("M8")
async def test_a_session_that_has_expired_makes_room_at_once(start: StartSessions, clock: Clock) -> None:
    sessions, _ = await start(max_sessions=1)
    first = (await sessions.create_session(ONE)).session

    clock.now_s += 3600
    assert (await sessions.create_session(ONE)).session != first
    assert len(sessions) == 1


async def test_a_session_that_ended_or_was_never_made_takes_nothing_of_its_worker(
    start: StartSessions, clock: Clock, fork_worker: StartChild
) -> None:
    pool = WorkerPool(fork_worker, workers=1)
    sessions, _ = await start(pool=pool)
    closed, expired = await begun(sessions), await begun(sessions)

    with pytest.raises(InvalidInput):
        await sessions.create_session(replace(ONE, height=40))  # the grid's frames are smaller
    await sessions.close_session(CloseSessionRequest(closed))
    clock.now_s += 3600
    sessions.reap()
    await sessions.drain()

    worker = await pool.place(0)
    assert worker.load == 0
    for session in (closed, expired):
        with pytest.raises(SessionNotFound):
            await worker.call(SnapshotRequest(session), SnapshotResponse)


@pytest.mark.fault("M8")
@pytest.mark.fault("G3")
async def test_three_hundred_sessions_leave_nothing_behind(start: StartSessions) -> None:
    sessions, workers = await start(workers=1)
    processes = [psutil.Process(), *workers]
    for _ in range(30):
        await sessions.close_session(CloseSessionRequest(await begun(sessions)))
    files = [process.num_fds() for process in processes]
    memory = [process.memory_info().rss for process in processes]

    for _ in range(300):
        session = await begun(sessions, replace(ONE, num_envs=4, idempotency_key="mine"))
        await sessions.step(StepRequest(session, 1, np.zeros((4, 1), np.int64), TOP))
        await sessions.close_session(CloseSessionRequest(session))

    assert len(sessions) == 0
    assert all(process.num_fds() <= before for process, before in zip(processes, files, strict=True))
    for process, before in zip(processes, memory, strict=True):
        assert process.memory_info().rss < 1.05 * before


@pytest.mark.fault("M6")
async def test_a_session_whose_worker_died_makes_room_and_frees_its_key_and_still_says_why_once(
    start: StartSessions, fork_worker: StartChild
) -> None:
    pool = WorkerPool(fork_worker, workers=1)
    sessions, (victim,) = await start(max_sessions=1, pool=pool)
    request = replace(ONE, idempotency_key="mine")
    lost, worker = await begun(sessions, request), await pool.place(0)

    victim.kill()
    await worker.wait_ended()
    again = await begun(sessions, request)

    assert again != lost
    with pytest.raises(WorkerLost):
        await sessions.step(StepRequest(lost, 1, UP))
    with pytest.raises(SessionNotFound):
        await sessions.step(StepRequest(lost, 1, UP))
    assert (await sessions.step(StepRequest(again, 1, UP))).step_id == 1


@pytest.mark.fault("M6")
async def test_a_lost_session_is_not_there_once_its_lease_has_ended(
    start: StartSessions, clock: Clock, fork_worker: StartChild
) -> None:
    pool = WorkerPool(fork_worker, workers=1)
    sessions, (victim,) = await start(pool=pool)
    lost, worker = await begun(sessions), await pool.place(0)
    victim.kill()
    await worker.wait_ended()

    sessions.reap()
    clock.now_s += 3600
    sessions.reap()

    with pytest.raises(SessionNotFound):
        await sessions.step(StepRequest(lost, 1, UP))


async def test_a_service_about_to_stop_finishes_what_was_begun_and_begins_nothing(start: StartSessions) -> None:
    sessions, _ = await start()
    session = await begun(sessions)
    stream = sessions.demonstrate(DemonstrateRequest("grid", "random", count=2))
    await anext(stream)
    step = asyncio.create_task(sessions.step(StepRequest(session, 1, UP)))
    await asyncio.sleep(0)

    await sessions.drain()

    assert step.done()
    for begin in (sessions.create_session(ONE), anext(stream)):
        with pytest.raises(Unavailable, match="about to stop"):
            await begin
    assert await snapshot(sessions, session)


@pytest.mark.fault("C18")
async def test_a_service_that_closes_does_not_wait_for_a_call_that_nobody_awaits(start: StartSessions) -> None:
    tasks = asyncio.all_tasks()
    sessions, (worker,) = await start(workers=1)
    session = await begun(sessions)
    stop(worker)
    step = asyncio.create_task(sessions.step(StepRequest(session, 1, UP)))
    await asyncio.sleep(0)
    step.cancel()

    await sessions.close()

    assert step.cancelled()
    assert not worker.is_running()
    assert asyncio.all_tasks() <= tasks


async def test_a_closed_service_has_no_processes_and_no_files_open(fork_worker: StartChild) -> None:
    files, processes, tasks = psutil.Process().num_fds(), set(children()), asyncio.all_tasks()
    sessions = SimCore(WorkerPool(fork_worker, workers=2))
    await sessions.start()
    await begun(sessions)

    await sessions.close()

    assert set(children()) == processes
    assert asyncio.all_tasks() <= tasks
    assert psutil.Process().num_fds() <= files  # garbage of earlier tests may close some
    assert len(sessions) == 0
