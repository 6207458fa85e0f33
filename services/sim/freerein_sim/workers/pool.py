"""The worker processes of a service: placement of sessions, and restart of workers that die."""

import asyncio
import logging
from contextlib import suppress

from freerein.errors import WorkerLost
from freerein.fork_server import StartChild, spawn
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse, Task
from freerein_sim.workers.worker import Worker, worker_lost

_LOG = logging.getLogger(__name__)
_RESTART_AFTER_S = (0.1, 0.4, 1.6, 0.0)
"""Pauses after a worker died while starting; then it is started again, after the last given up."""


class WorkerPool:
    """Worker processes for sessions, and others for demonstrations, so that no session waits for one.

    Args:
        start_child: Starts their processes.
        workers: Number of processes that hold sessions.
        demonstrators: Number of processes that record demonstrations; started on demand.
        stuck_s: Time without a reply after which a worker that was called is killed.

    Attributes:
        tasks: The tasks by name; empty before `start`.
        demonstrators: Number of demonstrations recorded in parallel.
    """

    def __init__(
        self, start_child: StartChild = spawn, *, workers: int = 2, demonstrators: int = 1, stuck_s: float = 120.0
    ) -> None:
        self.tasks: dict[str, Task] = {}
        self.demonstrators = demonstrators
        self._slots = [_WorkerSlot(start_child, stuck_s) for _ in range(workers)]
        self._demonstrator_slots = [_WorkerSlot(start_child, stuck_s) for _ in range(demonstrators)]
        self._idle: asyncio.LifoQueue[_WorkerSlot] = asyncio.LifoQueue()
        for slot in self._demonstrator_slots:
            self._idle.put_nowait(slot)

    async def start(self) -> None:
        """Starts the workers that hold sessions, and waits until they answer.

        Raises WorkerLost if one keeps dying.
        """
        try:
            workers = await asyncio.gather(*(slot.fill() for slot in self._slots))
        except WorkerLost:
            await self.close()
            raise
        self.tasks = {task.name: task for task in workers[0].tasks}

    async def place(self, num_envs: int) -> Worker:
        """Returns the worker with the least load and adds `num_envs` to it; the caller subtracts it again.

        Raises WorkerLost if all workers died and cannot be restarted.
        """
        lost = worker_lost()
        for slot in sorted(self._slots, key=lambda slot: slot.load):
            try:
                worker = await slot.fill()
            except WorkerLost as error:
                lost = error
                continue
            worker.load += num_envs
            return worker
        raise lost

    async def demonstrate(self, request: DemonstrateRequest) -> DemonstrateResponse:
        """Returns trajectory `first` of the request, as `Worker.call`; cancelling a queued call drops it."""
        slot = await self._idle.get()
        slot.demonstrating = asyncio.create_task(self._demonstrate(slot, request))
        return await asyncio.shield(slot.demonstrating)  # completed even if the caller is cancelled

    async def close(self) -> None:
        """Stops all workers."""
        await asyncio.gather(*(slot.close() for slot in (*self._slots, *self._demonstrator_slots)))

    async def _demonstrate(self, slot: "_WorkerSlot", request: DemonstrateRequest) -> DemonstrateResponse:
        try:
            worker = await slot.fill()
            return await worker.call(request, DemonstrateResponse)
        finally:
            self._idle.put_nowait(slot)


class _WorkerSlot:
    """Holds one worker, and starts the next when it dies."""

    def __init__(self, start_child: StartChild, stuck_s: float) -> None:
        self.demonstrating: asyncio.Task[DemonstrateResponse] | None = None  # a task that nothing refers to may vanish
        self._start_child = start_child
        self._stuck_s = stuck_s
        self._filling: asyncio.Task[Worker] | None = None
        self._refilling: asyncio.Task[None] | None = None
        self._worker: Worker | None = None
        self._is_closed = False

    @property
    def load(self) -> int:
        return 0 if self._worker is None or self._worker.is_lost else self._worker.load

    async def fill(self) -> Worker:
        """Returns its worker, after starting it if there is none."""
        if self._worker is not None and not self._worker.is_lost:
            return self._worker
        if self._is_closed:
            raise worker_lost()
        if self._filling is None:
            self._filling = asyncio.create_task(self._start())
        filling = self._filling
        try:
            return await asyncio.shield(filling)
        except asyncio.CancelledError:
            if filling.cancelled():  # and not the caller
                raise worker_lost() from None
            raise

    async def close(self) -> None:
        self._is_closed = True
        if self._filling is not None:
            self._filling.cancel()  # it may hang while it starts
            await asyncio.wait([self._filling])
        if self._worker is not None:
            await self._worker.close()
        if self._refilling is not None:
            await self._refilling

    async def _start(self) -> Worker:
        try:
            worker = await self._start_persistently()
        finally:
            self._filling = None
        self._worker = worker
        self._refilling = asyncio.create_task(self._refill(worker))
        return worker

    async def _start_persistently(self) -> Worker:
        """Starts a worker, again if it dies: what kills it from outside may have passed."""
        for pause_s in _RESTART_AFTER_S:
            with suppress(WorkerLost):
                return await Worker.start(self._start_child, stuck_s=self._stuck_s)
            await asyncio.sleep(pause_s)
        raise WorkerLost(
            f"A worker process died {len(_RESTART_AFTER_S)} times while starting.",
            hint="Look for what kills it, such as the memory limit.",
        )

    async def _refill(self, worker: Worker) -> None:
        await worker.wait_ended()
        if self._is_closed:
            return
        try:
            await self.fill()
        except WorkerLost:
            if not self._is_closed:
                _LOG.error("a worker keeps dying while starting; the next session starts another")
