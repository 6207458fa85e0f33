"""The worker processes of a service: where sessions are placed, and what takes the place of one that dies."""

import asyncio
import logging

from freerein.errors import WorkerLost
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse, ListTasksRequest, ListTasksResponse, Task
from freerein_sim.workers.connection import worker_lost
from freerein_sim.workers.worker import Worker

_LOG = logging.getLogger(__name__)


class WorkerPool:
    """Places for workers. Some hold sessions; others make demonstrations, so that no session waits for one.

    Args:
        workers: Processes that hold sessions.
        demonstrators: Processes that make demonstrations; they start when the first is asked for.
        stuck_s: A worker that leaves a call unanswered for so long hangs, and is killed.

    Attributes:
        tasks: The tasks by name, known after `start`.
    """

    def __init__(self, *, workers: int = 2, demonstrators: int = 1, stuck_s: float = 120.0) -> None:
        self.tasks: dict[str, Task] = {}
        self._hosts = [_Place(stuck_s) for _ in range(workers)]
        self._demonstrators = [_Demonstrator(stuck_s) for _ in range(demonstrators)]

    @property
    def demonstrators(self) -> int:
        """How many demonstrations are made at the same time."""
        return len(self._demonstrators)

    async def start(self) -> None:
        """Starts the workers that hold sessions, and waits until they answer.

        Raises:
            WorkerLost: One cannot start.
        """
        try:
            workers = await asyncio.gather(*(place.fill() for place in self._hosts))
        except WorkerLost:
            await self.close()
            raise
        listed = await workers[0].call(ListTasksRequest(), ListTasksResponse)
        self.tasks = {task.name: task for task in listed.tasks}

    async def place(self, num_envs: int) -> Worker:
        """Returns the worker with the least load, which `num_envs` is added to; whoever asked subtracts it again.

        Raises:
            WorkerLost: A worker died, and the next one cannot start.
        """
        worker = await min(self._hosts, key=lambda place: place.load).fill()
        worker.load += num_envs
        return worker

    async def demonstrate(self, request: DemonstrateRequest) -> DemonstrateResponse:
        """Returns the one trajectory at the request's `first`. A caller cancelled before its turn costs nothing.

        Raises:
            WorkerLost: Its worker died.
            ServiceError: The request is refused.
        """
        return await min(self._demonstrators, key=lambda each: each.load).make(request)

    async def close(self) -> None:
        """Ends all workers."""
        hosts, demonstrators = self._hosts, self._demonstrators
        await asyncio.gather(*(each.close() for each in hosts), *(each.close() for each in demonstrators))


class _Place:
    """A place for one worker. When a worker that has worked dies, the next one is started at once."""

    def __init__(self, stuck_s: float) -> None:
        self._stuck_s = stuck_s
        self._filling: asyncio.Task[Worker] | None = None
        self._refilling: asyncio.Task[None] | None = None
        self._worker: Worker | None = None
        self._is_closed = False

    @property
    def load(self) -> int:
        """The load of its worker."""
        return 0 if self._worker is None or self._worker.is_lost else self._worker.load

    async def fill(self) -> Worker:
        """Returns its worker, started first when there is none."""
        if self._worker is not None and not self._worker.is_lost:
            return self._worker
        if self._is_closed:
            raise worker_lost()
        if self._filling is None:
            self._filling = asyncio.create_task(self._start())
        return await asyncio.shield(self._filling)

    async def close(self) -> None:
        """Ends its worker; no other takes its place."""
        self._is_closed = True
        if self._filling is not None:
            await asyncio.wait([self._filling])
        if self._worker is not None:
            await self._worker.close()
        if self._refilling is not None:
            await self._refilling

    async def _start(self) -> Worker:
        try:
            worker = await Worker.start(stuck_s=self._stuck_s)
        finally:
            self._filling = None
        self._worker = worker
        self._refilling = asyncio.create_task(self._refill(worker))
        return worker

    async def _refill(self, worker: Worker) -> None:
        await worker.wait_ended()
        if self._is_closed:
            return
        try:
            await self.fill()
        except WorkerLost:
            _LOG.error("a worker died at its start; the next session starts another")


class _Demonstrator:
    """A place whose worker makes one demonstration at a time: they are long, and many may be asked for at once."""

    def __init__(self, stuck_s: float) -> None:
        self.load = 0
        self._place = _Place(stuck_s)
        self._turn = asyncio.Lock()
        self._making: asyncio.Task[DemonstrateResponse] | None = None

    async def make(self, request: DemonstrateRequest) -> DemonstrateResponse:
        """Returns a trajectory, made when those asked for earlier are."""
        self.load += 1
        try:
            await self._turn.acquire()
            self._making = asyncio.create_task(self._make(request))  # the turn lasts, whoever still waits
            return await asyncio.shield(self._making)
        finally:
            self.load -= 1

    async def close(self) -> None:
        """Ends its worker."""
        await self._place.close()

    async def _make(self, request: DemonstrateRequest) -> DemonstrateResponse:
        try:
            worker = await self._place.fill()
            return await worker.call(request, DemonstrateResponse)
        finally:
            self._turn.release()
