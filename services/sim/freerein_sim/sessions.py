"""Sessions: who holds which environments, for how long, and what was answered last. The core of the sim service.

The worlds live in worker processes. Here are the rules: leases, quotas, bounds, and that a call is made once however
often it is asked for.
"""

import asyncio
import contextlib
import secrets
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from freerein.errors import (
    AlreadyExists,
    Internal,
    InvalidInput,
    NotFound,
    Overloaded,
    SessionNotFound,
    StepOutOfOrder,
    Unavailable,
    WorkerLost,
)
from freerein.types import sim
from freerein_sim.workers.connection import worker_lost
from freerein_sim.workers.pool import WorkerPool
from freerein_sim.workers.protocol import check_frames
from freerein_sim.workers.worker import Worker

MAX_ENVS = 64
MAX_COUNT = 100_000
DEFAULT_LEASE_S = 60.0
MAX_LEASE_S = 3600.0

_REAP_EVERY_S = 1.0
_SEED_BITS = 53  # survive JSON in any language

R = TypeVar("R")


@dataclass(eq=False)
class _Session:
    """A session: on which worker, until when, and how far it is."""

    id: str
    made_by: sim.CreateSessionRequest  # with its defaults filled in
    task: sim.Task
    worker: Worker
    expires_at: float
    step_id: int = 0
    answered: tuple[sim.StepRequest, sim.StepResponse] | None = None
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)

    def check_frames(self, cameras: Sequence[str], *, height: int = 0, width: int = 0, times: int = 1) -> None:
        """Checks the size of a reply that shows every environment so many times."""
        made_by = self.made_by
        height, width = height or made_by.height, width or made_by.width
        check_frames(self.task, cameras, height=height, width=width, images=times * made_by.num_envs)


class Sessions:
    """The sessions of one service. For one event loop.

    Calls on one session are made one after the other. A call whose caller goes away is finished all the same, so that
    it can be asked for again. When a session's worker dies the next call on it says `WorkerLost`.

    Args:
        pool: The worker processes; started and closed with the sessions.
        max_sessions: Sessions that may be open at once.
        clock: Tells the time in seconds, never backwards.
    """

    def __init__(
        self, pool: WorkerPool, *, max_sessions: int = 64, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._pool = pool
        self._max_sessions = max_sessions
        self._clock = clock
        self._sessions: dict[str, _Session] = {}
        self._created: dict[str, tuple[sim.CreateSessionRequest, asyncio.Task[sim.CreateSessionResponse]]] = {}
        self._creating = 0
        self._in_flight: set[asyncio.Task[Any]] = set()
        self._reaper: asyncio.Task[None] | None = None
        self._draining = False

    def __len__(self) -> int:
        """Returns the number of open sessions."""
        return len(self._sessions)

    async def start(self) -> None:
        """Starts the workers, and the reaper of sessions whose lease has ended.

        Raises:
            WorkerLost: A worker cannot start.
        """
        await self._pool.start()
        self._reaper = asyncio.create_task(self._reap_for_ever())

    async def drain(self) -> None:
        """Refuses new sessions and demonstrations from now on, and returns when what is now in flight has finished.

        Open sessions go on, so that their clients can take a snapshot and leave.
        """
        self._draining = True
        if self._in_flight:
            await asyncio.wait(set(self._in_flight))

    async def close(self) -> None:
        """Drains, then ends the workers and all sessions with them."""
        await self.drain()
        if self._reaper is not None:
            self._reaper.cancel()
        await self._pool.close()
        self._sessions.clear()

    async def list_tasks(self, request: sim.ListTasksRequest) -> sim.ListTasksResponse:
        """Returns the tasks. Raises Unavailable while the workers are starting."""
        return sim.ListTasksResponse(tuple(self._tasks().values()))

    async def create_session(self, request: sim.CreateSessionRequest) -> sim.CreateSessionResponse:
        """Makes a session, or returns the one made with the same idempotency key.

        Raises:
            InvalidInput: A number is out of its bounds.
            NotFound: There is no such task.
            AlreadyExists: The key was used for another request.
            Overloaded: As many sessions are open as may be.
            Unavailable: The service is about to stop.
        """
        self._check_serving()
        earlier, making = self._created.get(request.idempotency_key, (request, None))
        if earlier != request:
            raise AlreadyExists(
                "`idempotency_key` must be new, or come with the request it first came with; got another request.",
                field="idempotency_key",
                hint="Choose another key.",
            )
        if making is None:
            making = self._run(self._create(self._resolved(request)))
            if request.idempotency_key:
                self._created[request.idempotency_key] = request, making
        response = await asyncio.shield(making)
        self._renew(response.session)
        return response

    async def reset(self, request: sim.ResetRequest) -> sim.ResetResponse:
        """Begins new episodes, as `VectorEnv.reset`. The count of steps goes on."""

        async def work(session: _Session) -> sim.ResetResponse:
            session.check_frames(request.cameras)
            return await session.worker.call(request, sim.ResetResponse)

        return await self._exclusively(request.session, work)

    async def step(self, request: sim.StepRequest) -> sim.StepResponse:
        """Steps every environment once, as `VectorEnv.step`; the last step asked for again is answered as it was.

        Raises:
            StepOutOfOrder: `step_id` is neither the next nor the last, or the last one came with other actions.
        """

        async def work(session: _Session) -> sim.StepResponse:
            if session.answered is not None and request.step_id == session.step_id:
                return _recorded(request, *session.answered)
            if request.step_id != session.step_id + 1:
                raise StepOutOfOrder(
                    f"`step_id` must be {session.step_id + 1}, one more than the last; got {request.step_id}.",
                    field="step_id",
                    hint="Count every step from 1; resets do not begin again, Restore says where to go on.",
                )
            session.check_frames(request.cameras, times=2)  # all episodes may end, and have final frames
            response = await session.worker.call(request, sim.StepResponse)
            session.step_id, session.answered = request.step_id, (request, response)
            return response

        return await self._exclusively(request.session, work)

    async def render(self, request: sim.RenderRequest) -> sim.RenderResponse:
        """Returns what the cameras see, as `VectorEnv.render`."""

        async def work(session: _Session) -> sim.RenderResponse:
            cameras = request.cameras or tuple(camera.name for camera in session.task.cameras)
            session.check_frames(cameras, height=request.height, width=request.width)
            return await session.worker.call(request, sim.RenderResponse)

        return await self._exclusively(request.session, work)

    async def snapshot(self, request: sim.SnapshotRequest) -> sim.SnapshotResponse:
        """Returns the session's complete state, as `VectorEnv.snapshot`."""
        return await self._exclusively(
            request.session, lambda session: session.worker.call(request, sim.SnapshotResponse)
        )

    async def restore(self, request: sim.RestoreRequest) -> sim.RestoreResponse:
        """Puts the session into the state of a snapshot, as `VectorEnv.restore`; earlier steps cannot be repeated."""

        async def work(session: _Session) -> sim.RestoreResponse:
            response = await session.worker.call(request, sim.RestoreResponse)
            session.step_id, session.answered = response.step_id, None
            return response

        return await self._exclusively(request.session, work)

    async def demonstrate(self, request: sim.DemonstrateRequest) -> AsyncIterator[sim.DemonstrateResponse]:
        """Yields trajectories in order, a few made ahead; no longer iterating is all that cancelling takes.

        Raises:
            InvalidInput: The request names what the task does not have, or more than may be asked for.
            NotFound: There is no such task.
            FailedPrecondition: The expert failed again and again.
            Unavailable: The service is about to stop.
        """
        task = self._task(request.task)
        if not (1 <= request.count <= MAX_COUNT and request.first <= request.count):
            raise InvalidInput(
                f"`count` must be 1 to {MAX_COUNT} and `first` at most `count`; got {request.count}, {request.first}.",
                field="count",
            )
        cameras = request.cameras or (task.cameras[0].name,)
        check_frames(task, cameras, height=request.height, width=request.width, images=task.max_episode_steps)
        making: deque[asyncio.Task[sim.DemonstrateResponse]] = deque()
        try:
            for index in range(request.first, request.count):
                self._check_serving()
                making.append(asyncio.create_task(self._pool.demonstrate(replace(request, first=index))))
                if len(making) == self._pool.demonstrators:
                    yield await making.popleft()
            while making:
                yield await making.popleft()
        finally:
            for each in making:
                each.cancel()
            await asyncio.gather(*making, return_exceptions=True)

    async def close_session(self, request: sim.CloseSessionRequest) -> sim.CloseSessionResponse:
        """Ends a session; one that is not there has ended already."""

        async def work(session: _Session) -> None:
            self._forget(session)
            await session.worker.call(request, sim.CloseSessionResponse)

        with contextlib.suppress(SessionNotFound, WorkerLost):
            await self._exclusively(request.session, work)
        return sim.CloseSessionResponse()

    def reap(self) -> None:
        """Ends the sessions whose lease has ended. The reaper does so every second."""
        for session in [session for session in self._sessions.values() if self._has_expired(session)]:
            self._forget(session)
            self._run(_close_quietly(session))

    async def _create(self, request: sim.CreateSessionRequest) -> sim.CreateSessionResponse:
        try:
            self._check_quota()
            self._creating += 1
            try:
                return await self._place(request)
            finally:
                self._creating -= 1
        except BaseException:
            self._created.pop(request.idempotency_key, None)
            raise

    async def _place(self, request: sim.CreateSessionRequest) -> sim.CreateSessionResponse:
        worker = await self._pool.place(request.num_envs)
        try:
            response = await worker.call(request, sim.CreateSessionResponse)
        except BaseException:
            worker.load -= request.num_envs
            raise
        expires_at = self._clock() + request.lease_s
        self._sessions[response.session] = _Session(response.session, request, response.task, worker, expires_at)
        return response

    async def _exclusively(self, session_id: str, work: Callable[[_Session], Coroutine[Any, Any, R]]) -> R:
        """Does work on a session when no other is done on it. Once begun it is finished, whoever still waits.

        Raises:
            SessionNotFound: There is no such session, or it ended while the call waited for its turn.
            WorkerLost: Its worker is dead.
        """
        session = self._find(session_id)
        self._renew(session_id)
        await session.lock.acquire()
        return await asyncio.shield(self._run(self._work(session, work)))

    async def _work(self, session: _Session, work: Callable[[_Session], Coroutine[Any, Any, R]]) -> R:
        try:
            if session.id not in self._sessions:
                raise worker_lost() if session.worker.is_lost else _no_such_session()
            return await work(session)
        except (WorkerLost, Internal):
            self._forget(session)
            raise
        finally:
            self._renew(session.id)
            session.lock.release()

    def _run(self, work: Coroutine[Any, Any, R]) -> "asyncio.Task[R]":
        """Starts work that draining waits for."""
        task = asyncio.create_task(work)
        self._in_flight.add(task)
        task.add_done_callback(self._in_flight.discard)
        return task

    def _forget(self, session: _Session) -> None:
        """Frees a session's place; twice is fine."""
        if self._sessions.pop(session.id, None) is not None:
            self._created.pop(session.made_by.idempotency_key, None)
            session.worker.load -= session.made_by.num_envs

    def _find(self, session_id: str) -> _Session:
        session = self._sessions.get(session_id)
        if session is None or self._has_expired(session):
            raise _no_such_session()
        return session

    def _renew(self, session_id: str) -> None:
        if (session := self._sessions.get(session_id)) is not None:
            session.expires_at = self._clock() + session.made_by.lease_s

    def _has_expired(self, session: _Session) -> bool:
        return self._clock() >= session.expires_at and not session.lock.locked()

    async def _reap_for_ever(self) -> None:
        while True:
            await asyncio.sleep(_REAP_EVERY_S)
            self.reap()

    def _resolved(self, request: sim.CreateSessionRequest) -> sim.CreateSessionRequest:
        """Returns the request with its defaults filled in.

        Raises:
            NotFound: There is no such task.
            InvalidInput: A number is out of its bounds.
            Unavailable: The workers have not started yet.
        """
        task = self._task(request.task)
        check_frames(task, (), height=request.height, width=request.width, images=0)
        num_envs, lease_s = request.num_envs or 1, request.lease_s or DEFAULT_LEASE_S
        if not 1 <= num_envs <= MAX_ENVS:
            raise InvalidInput(f"`num_envs` must be 1 to {MAX_ENVS}; got {num_envs}.", field="num_envs")
        if not 0 < lease_s <= MAX_LEASE_S:
            raise InvalidInput(
                f"`lease_s` must be above 0 and at most {MAX_LEASE_S:.0f} seconds; got another.", field="lease_s"
            )
        seed = secrets.randbits(_SEED_BITS) if request.seed is None else request.seed
        return replace(request, num_envs=num_envs, lease_s=lease_s, seed=seed)

    def _task(self, name: str) -> sim.Task:
        if (task := self._tasks().get(name)) is None:
            raise NotFound("There is no such task.", field="task", hint="ListTasks names those that there are.")
        return task

    def _tasks(self) -> dict[str, sim.Task]:
        if not self._pool.tasks:
            raise Unavailable("The workers must have started; they are starting.", hint="Try again in a second.")
        return self._pool.tasks

    def _check_quota(self) -> None:
        if len(self._sessions) + self._creating >= self._max_sessions:
            raise Overloaded(
                f"At most {self._max_sessions} sessions may be open at once, and so many are.",
                hint="Close one, or wait until a lease has ended.",
            )

    def _check_serving(self) -> None:
        if self._draining:
            raise Unavailable("The service is about to stop.", hint="Ask another replica, or try again later.")


def _recorded(request: sim.StepRequest, last: sim.StepRequest, response: sim.StepResponse) -> sim.StepResponse:
    """Returns the response to the last step, when this is the last step again."""
    is_same = (
        request.cameras == last.cameras
        and request.actions.dtype == last.actions.dtype
        and request.actions.shape == last.actions.shape
        and request.actions.tobytes() == last.actions.tobytes()
    )
    if not is_same:
        raise StepOutOfOrder(
            f"Step {request.step_id} was made already; got it again with other actions or cameras.",
            field="step_id",
            hint="Repeat a step only as it was. The next step's `step_id` is one more.",
        )
    return response


async def _close_quietly(session: _Session) -> None:
    with contextlib.suppress(WorkerLost):
        await session.worker.call(sim.CloseSessionRequest(session.id), sim.CloseSessionResponse)


def _no_such_session() -> SessionNotFound:
    return SessionNotFound(
        "There is no such session: it was never made, was closed, or its lease has ended.",
        field="session",
        hint="Create one. Any call renews its lease.",
    )
