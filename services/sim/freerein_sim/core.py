"""The core of the sim service: sessions with leases, quotas and idempotent calls; worlds run in worker processes."""

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine
from dataclasses import replace
from typing import Any, TypeVar

from freerein.errors import (
    AlreadyExists,
    Internal,
    NotFound,
    Overloaded,
    SessionNotFound,
    Unavailable,
    WorkerLost,
    must_be,
    quoted,
)
from freerein.types import sim
from freerein_sim.session import Session, session_not_found, with_defaults
from freerein_sim.workers import snapshots
from freerein_sim.workers.pool import WorkerPool
from freerein_sim.workers.protocol import check_frames
from freerein_sim.workers.worker import worker_lost

MAX_COUNT = 100_000
MAX_SETTLE = 1_000
MAX_RECIPES = 10_000
_REAP_EVERY_S = 1.0
_DRAIN_S = 0.5
"""After the servers have drained, which may take 8 s of the 10 s from SIGTERM to exit; workers may take 1 s to end."""

R = TypeVar("R")


class SimCore:
    """The sessions of one service, for one event loop.

    Calls on one session are serialised. A call whose caller goes away is completed, so that it can be repeated. After a
    session's worker dies, the next call on it raises `WorkerLost`.

    Args:
        pool: The worker processes; started and closed with the sessions.
        max_sessions: Greatest number of open sessions.
        max_envs: Greatest number of their environments, which bounds the memory of the workers.
        clock: Monotonic clock, in seconds.
    """

    def __init__(
        self,
        pool: WorkerPool,
        *,
        max_sessions: int = 64,
        max_envs: int = 512,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._pool = pool
        self._max_sessions = max_sessions
        self._max_envs = max_envs
        self._clock = clock
        self._sessions: dict[str, Session] = {}
        self._lost: dict[str, float] = {}  # ends of the leases of sessions whose workers died, until their next calls
        self._created: dict[str, tuple[sim.CreateSessionRequest, asyncio.Task[sim.CreateSessionResponse]]] = {}
        self._creating: list[int] = []  # numbers of environments
        self._in_flight: set[asyncio.Task[Any]] = set()
        self._reaper: asyncio.Task[None] | None = None
        self._draining = False

    def __len__(self) -> int:
        """Returns the number of open sessions."""
        return len(self._sessions)

    async def start(self) -> None:
        """Starts the workers, and the task that closes expired sessions. Raises WorkerLost if a worker cannot start."""
        await self._pool.start()
        self._reaper = asyncio.create_task(self._reap_periodically())

    async def drain(self) -> None:
        """Refuses new sessions and demonstrations, and waits for the calls in flight; open sessions go on."""
        self._draining = True
        if self._in_flight:
            await asyncio.wait(set(self._in_flight))

    async def close(self) -> None:
        """Drains for half a second, then stops the workers, which ends all sessions and whatever call is left."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_DRAIN_S):
                await self.drain()
        if self._reaper is not None:
            self._reaper.cancel()
        await self._pool.close()
        self._sessions.clear()

    async def list_tasks(self, request: sim.ListTasksRequest) -> sim.ListTasksResponse:
        """Returns the tasks. Raises Unavailable while the workers are starting."""
        return sim.ListTasksResponse(tuple(self._tasks().values()))

    async def create_session(self, request: sim.CreateSessionRequest) -> sim.CreateSessionResponse:
        """Creates a session, or returns the open one that was created with the same idempotency key."""
        self._check_not_draining()
        self.reap()  # neither is an ended session the key's, nor a reason to refuse one
        request = replace(request, conditions=tuple(sorted(request.conditions)))  # their order does not matter
        earlier, making = self._created.get(request.idempotency_key, (request, None))
        if earlier != request:
            raise AlreadyExists(
                "`idempotency_key` must be new, or come with the request it first came with; got another request.",
                field="idempotency_key",
                hint="Choose another key.",
            )
        if making is None:
            making = self._run(self._create(with_defaults(request, self._task(request.task))))
            if request.idempotency_key:
                self._created[request.idempotency_key] = request, making
        response = await asyncio.shield(making)
        self._renew(response.session)
        return response

    async def reset(self, request: sim.ResetRequest) -> sim.ResetResponse:
        """Begins new episodes, as `VectorEnv.reset`; `step_id` goes on counting."""
        return await self._call(request, sim.ResetResponse, lambda session: session.check_frames(request.cameras))

    async def step(self, request: sim.StepRequest) -> sim.StepResponse:
        """Steps every environment once, as `VectorEnv.step`; repeating the last step returns its recorded response."""

        async def work(session: Session) -> sim.StepResponse:
            response = session.recorded_response(request)
            if response is None:
                session.check_frames(request.cameras, times=2)  # if all episodes end there are final frames, too
                response = await session.worker.call(request, sim.StepResponse)
                session.step_id, session.last_step = request.step_id, (request, response)
            return response

        return await self._exclusively(request.session, work)

    async def render(self, request: sim.RenderRequest) -> sim.RenderResponse:
        """Renders, as `VectorEnv.render`."""

        def check(session: Session) -> None:
            cameras = request.cameras or tuple(camera.name for camera in session.task.cameras)
            session.check_frames(cameras, height=request.height, width=request.width)

        return await self._call(request, sim.RenderResponse, check)

    async def snapshot(self, request: sim.SnapshotRequest) -> sim.SnapshotResponse:
        """Returns the complete state, as `VectorEnv.snapshot`."""
        return await self._call(request, sim.SnapshotResponse)

    async def restore(self, request: sim.RestoreRequest) -> sim.RestoreResponse:
        """Restores a snapshot, as `VectorEnv.restore`; earlier steps can then not be repeated."""

        async def work(session: Session) -> sim.RestoreResponse:
            await asyncio.to_thread(snapshots.decode, request.snapshot)  # untrusted: checked before the worker sees it
            response = await session.worker.call(request, sim.RestoreResponse)
            session.step_id, session.last_step = response.step_id, None
            return response

        return await self._exclusively(request.session, work)

    async def demonstrate(self, request: sim.DemonstrateRequest) -> AsyncIterator[sim.DemonstrateResponse]:
        """Yields trajectories in order, computed a few ahead; closing the iterator cancels the rest."""
        task = self._task(request.task)
        if not (1 <= request.count <= MAX_COUNT and request.first <= request.count):
            got = f"{request.count}, {request.first}"
            raise must_be("count", f"1 to {MAX_COUNT} and `first` at most `count`", got)
        can_settle = request.behaviour == "expert" and not (task.action.choices and task.action.hold < 0)
        if request.settle > (MAX_SETTLE if can_settle else 0):
            rule = f"at most {MAX_SETTLE}, of the expert, in a task with an action that holds"
            raise must_be("settle", rule, f"{request.settle} of {request.behaviour}", hint="Leave it out.")
        cameras = request.cameras or (task.cameras[0].name,)
        check_frames(task, cameras, height=request.height, width=request.width, images=task.max_episode_steps)
        making: deque[asyncio.Task[sim.DemonstrateResponse]] = deque()
        try:
            for index in range(request.first, request.count):
                self._check_not_draining()
                making.append(asyncio.create_task(self._pool.demonstrate(replace(request, first=index))))
                if len(making) == self._pool.demonstrators:
                    yield await making.popleft()
            while making:
                yield await making.popleft()
        finally:
            for each in making:
                each.cancel()
            await asyncio.gather(*making, return_exceptions=True)

    async def draw_recipes(self, request: sim.DrawRecipesRequest) -> sim.DrawRecipesResponse:
        """Returns recipes of a task."""
        self._task(request.task)
        if not 1 <= request.count <= MAX_RECIPES:
            raise must_be("count", f"1 to {MAX_RECIPES}", request.count)
        worker = await self._pool.place(0)
        return await worker.call(request, sim.DrawRecipesResponse)

    async def check(self, request: sim.CheckRequest) -> sim.CheckResponse:
        """Returns where a predicate of a privileged session's task holds, or what a measure is."""
        return await self._call(request, sim.CheckResponse, lambda session: session.check_privileged("Check"))

    async def expert_actions(self, request: sim.ExpertActionsRequest) -> sim.ExpertActionsResponse:
        """Returns a scripted policy's next actions in a privileged session, as `VectorEnv.expert_actions`."""
        return await self._call(
            request, sim.ExpertActionsResponse, lambda session: session.check_privileged("ExpertActions")
        )

    async def close_session(self, request: sim.CloseSessionRequest) -> sim.CloseSessionResponse:
        """Closes a session; does nothing for an unknown one."""

        async def work(session: Session) -> None:
            self._forget(session)
            await session.worker.call(request, sim.CloseSessionResponse)

        with contextlib.suppress(SessionNotFound, WorkerLost):
            await self._exclusively(request.session, work)
        return sim.CloseSessionResponse()

    def reap(self) -> None:
        """Closes expired sessions, and gives up lost ones; called every second, and before a session is created."""
        for session in tuple(self._sessions.values()):
            if session.worker.is_lost:
                self._lost[session.id] = session.expires_at
                self._forget(session)
            elif self._has_expired(session):
                self._forget(session)
                self._run(_close_quietly(session))
        self._lost = {lost: expires_at for lost, expires_at in self._lost.items() if self._clock() < expires_at}

    async def _create(self, request: sim.CreateSessionRequest) -> sim.CreateSessionResponse:
        worker = None
        self._creating.append(request.num_envs)
        try:
            self._check_room()
            worker = await self._pool.place(request.num_envs)
            response = await worker.call(request, sim.CreateSessionResponse)
        except BaseException:
            self._created.pop(request.idempotency_key, None)
            if worker is not None:
                worker.load -= request.num_envs
            raise
        finally:
            self._creating.remove(request.num_envs)
        expires_at = self._clock() + request.lease_s
        self._sessions[response.session] = Session(response.session, request, response.task, worker, expires_at)
        return response

    def _check_room(self) -> None:
        """Raises Overloaded when the sessions that are open or being created are too many, or too large."""
        num_envs = [session.request.num_envs for session in self._sessions.values()] + self._creating
        if len(num_envs) > self._max_sessions:
            raise Overloaded(
                f"At most {self._max_sessions} sessions may be open at once; the limit is reached.",
                hint="Close one, or wait until a lease ends.",
            )
        if sum(num_envs) > self._max_envs:
            raise Overloaded(
                f"All sessions may have at most {self._max_envs} environments together; they would have "
                f"{sum(num_envs)}.",
                hint="Close a session, wait until a lease ends, or ask for fewer; FREEREIN_SIM_ENVS sets the limit.",
            )

    async def _call(self, request: Any, response: type[R], check: Callable[[Session], None] = lambda _: None) -> R:
        """Calls the worker of the request's session, after a check."""

        async def work(session: Session) -> R:
            check(session)
            return await session.worker.call(request, response)

        return await self._exclusively(request.session, work)

    async def _exclusively(self, session_id: str, work: Callable[[Session], Coroutine[Any, Any, R]]) -> R:
        """Runs `work` while holding the session's lock; once begun it is completed, even if the caller is cancelled."""
        session = self._sessions.get(session_id)
        if self._lost.pop(session_id, None) is not None:
            raise worker_lost()
        if session is None or self._has_expired(session):
            raise session_not_found()
        self._renew(session_id)
        await session.lock.acquire()
        return await asyncio.shield(self._run(self._work(session, work)))

    async def _work(self, session: Session, work: Callable[[Session], Coroutine[Any, Any, R]]) -> R:
        try:
            if session.id not in self._sessions:
                raise worker_lost() if session.worker.is_lost else session_not_found()
            return await work(session)
        except (WorkerLost, Internal):
            self._forget(session)
            raise
        finally:
            self._renew(session.id)
            session.lock.release()

    def _run(self, work: Coroutine[Any, Any, R]) -> "asyncio.Task[R]":
        """Starts a task that `drain` waits for."""
        task = asyncio.create_task(work)
        self._in_flight.add(task)
        task.add_done_callback(self._in_flight.discard)
        return task

    def _forget(self, session: Session) -> None:
        """Removes a session; may be called twice."""
        if self._sessions.pop(session.id, None) is not None:
            self._created.pop(session.request.idempotency_key, None)
            session.worker.load -= session.request.num_envs

    def _renew(self, session_id: str) -> None:
        if (session := self._sessions.get(session_id)) is not None:
            session.expires_at = self._clock() + session.request.lease_s

    def _has_expired(self, session: Session) -> bool:
        return self._clock() >= session.expires_at and not session.lock.locked()

    async def _reap_periodically(self) -> None:
        while True:
            await asyncio.sleep(_REAP_EVERY_S)
            self.reap()

    def _task(self, name: str) -> sim.Task:
        if (task := self._tasks().get(name)) is None:
            raise NotFound(
                f"`task` must be the name of a task; got {quoted(name)}.",
                field="task",
                hint="ListTasks names those that there are.",
            )
        return task

    def _tasks(self) -> dict[str, sim.Task]:
        if not self._pool.tasks:
            raise Unavailable("The workers are still starting.", hint="Try again in a second.")
        return self._pool.tasks

    def _check_not_draining(self) -> None:
        if self._draining:
            raise Unavailable("The service is about to stop.", hint="Ask another replica, or try again later.")


async def _close_quietly(session: Session) -> None:
    with contextlib.suppress(WorkerLost):
        await session.worker.call(sim.CloseSessionRequest(session.id), sim.CloseSessionResponse)
