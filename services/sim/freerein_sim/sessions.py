"""Sessions: who holds which environments, for how long, and what was answered last. The core of the sim service.

The worlds live in worker processes. Here are the rules: leases, quotas, bounds, and that a call is made once however
often it is asked for.
"""

import asyncio
import contextlib
import secrets
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from freerein.errors import (
    AlreadyExists,
    FailedPrecondition,
    Internal,
    InvalidInput,
    NotFound,
    Overloaded,
    Unavailable,
    WorkerLost,
)
from freerein.types import sim
from freerein_sim.workers.connection import worker_lost
from freerein_sim.workers.pool import Pool
from freerein_sim.workers.worker import Worker

MAX_ENVS = 64
MAX_SIZE_PX = 256
MAX_COUNT = 100_000
MAX_FRAME_BYTES = 63 * 2**20
"""Of one reply; a message has at most 64 MiB, so there are at most 64 Mpx in one."""

DEFAULT_LEASE_S = 60.0
MAX_LEASE_S = 3600.0

_REAP_EVERY_S = 1.0

R = TypeVar("R")


@dataclass(eq=False)
class _Session:
    """A session: on which worker, until when, and how far it is."""

    id: str
    key: str
    worker: Worker
    task: sim.Task
    num_envs: int
    height: int
    width: int
    lease_s: float
    expires_at: float
    step_id: int = 0
    answered: tuple[sim.StepRequest, sim.StepResponse] | None = None
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)


class Sessions:
    """The sessions of one service. For one event loop.

    Calls on one session are made one after the other. A call whose caller goes away is finished all the same, so that
    it can be asked for again. When a session's worker dies the next call on it says `WorkerLost`.

    Args:
        pool: The worker processes; started and closed with the sessions.
        max_sessions: Sessions that may be open at once.
        clock: Tells the time in seconds, never backwards.
    """

    def __init__(self, pool: Pool, *, max_sessions: int = 64, clock: Callable[[], float] = time.monotonic) -> None:
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
        """Refuses new sessions and demonstrations from now on, and returns when what is in flight has finished.

        Open sessions go on, so that their clients can take a snapshot and leave.
        """
        self._draining = True
        while self._in_flight:
            await asyncio.wait(self._in_flight)

    async def close(self) -> None:
        """Drains, then ends the workers and all sessions with them."""
        await self.drain()
        if self._reaper is not None:
            self._reaper.cancel()
        await self._pool.close()
        self._sessions.clear()

    async def list_tasks(self, request: sim.ListTasksRequest) -> sim.ListTasksResponse:
        """Returns the tasks."""
        return sim.ListTasksResponse(tuple(self._pool.tasks.values()))

    async def create_session(self, request: sim.CreateSessionRequest) -> sim.CreateSessionResponse:
        """Makes a session, or returns the one made with the same idempotency key.

        Raises:
            InvalidInput: A number is out of its bounds.
            NotFound: There is no such task.
            AlreadyExists: The key was used for another request.
            Overloaded: As many sessions are open as may be.
            Unavailable: The service is about to stop.
        """
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
        """Begins new episodes, as `Envs.reset`. The count of steps goes on."""

        async def work(session: _Session) -> sim.ResetResponse:
            _check_size(session.task, request.cameras, session.height, session.width, images=session.num_envs)
            return await session.worker.call(request, sim.ResetResponse)

        return await self._exclusively(request.session, work)

    async def step(self, request: sim.StepRequest) -> sim.StepResponse:
        """Steps every environment once, as `Envs.step`; the last step asked for again is answered as it was.

        Raises:
            FailedPrecondition: `step_id` is neither the next nor the last, or the last one came with other actions.
        """

        async def work(session: _Session) -> sim.StepResponse:
            if session.answered is not None and request.step_id == session.step_id:
                return _answered_before(request, *session.answered)
            if request.step_id != session.step_id + 1:
                raise FailedPrecondition(
                    f"`step_id` must be {session.step_id + 1}, one more than the last; got {request.step_id}.",
                    field="step_id",
                    hint="Count every step from 1; resets do not begin again, Restore says where to go on.",
                )
            images = 2 * session.num_envs  # all episodes may end, and each has a final frame then
            _check_size(session.task, request.cameras, session.height, session.width, images=images)
            response = await session.worker.call(request, sim.StepResponse)
            session.step_id, session.answered = request.step_id, (request, response)
            return response

        return await self._exclusively(request.session, work)

    async def render(self, request: sim.RenderRequest) -> sim.RenderResponse:
        """Returns what the cameras see, as `Envs.render`."""

        async def work(session: _Session) -> sim.RenderResponse:
            cameras = request.cameras or tuple(camera.name for camera in session.task.cameras)
            height, width = request.height or session.height, request.width or session.width
            _check_size(session.task, cameras, height, width, images=session.num_envs)
            return await session.worker.call(request, sim.RenderResponse)

        return await self._exclusively(request.session, work)

    async def snapshot(self, request: sim.SnapshotRequest) -> sim.SnapshotResponse:
        """Returns the session's complete state, as `Envs.snapshot`."""
        return await self._exclusively(
            request.session, lambda session: session.worker.call(request, sim.SnapshotResponse)
        )

    async def restore(self, request: sim.RestoreRequest) -> sim.RestoreResponse:
        """Puts the session into the state of a snapshot, as `Envs.restore`; no earlier step can be repeated then."""

        async def work(session: _Session) -> sim.RestoreResponse:
            response = await session.worker.call(request, sim.RestoreResponse)
            session.step_id, session.answered = response.step_id, None
            return response

        return await self._exclusively(request.session, work)

    async def demonstrate(self, request: sim.DemonstrateRequest) -> AsyncIterator[sim.DemonstrateResponse]:
        """Yields trajectories, each made when it is asked for; no longer iterating is all that cancelling takes.

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
        _check_size(task, cameras, request.height, request.width, images=task.max_episode_steps)
        for index in range(request.first, request.count):
            self._check_serving()
            yield await self._pool.demonstrate(replace(request, first=index))

    async def close_session(self, request: sim.CloseSessionRequest) -> sim.CloseSessionResponse:
        """Ends a session; one that is not there has ended already."""

        async def work(session: _Session) -> None:
            self._forget(session)
            await session.worker.call(request, sim.CloseSessionResponse)

        with contextlib.suppress(NotFound, WorkerLost):
            await self._exclusively(request.session, work)
        return sim.CloseSessionResponse()

    def reap(self) -> None:
        """Ends the sessions whose lease has ended. The reaper does so every second."""
        for session in [session for session in self._sessions.values() if self._has_expired(session)]:
            self._forget(session)
            self._run(_close_quietly(session))

    # The ends of a session

    async def _create(self, request: sim.CreateSessionRequest) -> sim.CreateSessionResponse:
        if len(self._sessions) + self._creating >= self._max_sessions:
            raise Overloaded(
                f"At most {self._max_sessions} sessions may be open at once; all are.",
                hint="Close one, or wait until a lease has ended.",
            )
        self._creating += 1
        try:
            return await self._place(request)
        finally:
            self._creating -= 1
