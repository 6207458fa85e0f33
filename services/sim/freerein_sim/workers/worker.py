"""The service's side: one child process, and the calls that wait for it."""

import asyncio
import logging
import os
import socket
import subprocess
import sys
from typing import TypeVar

from freerein.types.sim import ListTasksRequest, ListTasksResponse
from freerein_sim.workers import protocol
from freerein_sim.workers.connection import Connection, worker_lost

_LOG = logging.getLogger(__name__)
_START_S = 60.0
_EXIT_S = 1.0
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "0"}
"""For BLAS and Mesa, where the operator says nothing. Mesa's 0 is no thread beside the caller's, which is faster."""

Response = TypeVar("Response")


class Worker:
    """A child process that hosts sessions. When it dies its calls fail, and it stays dead.

    Attributes:
        load: Environments placed on it; whoever places them keeps it.
    """

    def __init__(self, process: "subprocess.Popen[bytes]", connection: Connection, *, stuck_s: float) -> None:
        self.load = 0
        self._process = process
        self._connection = connection
        self._stuck_s = stuck_s
        self._reaping = asyncio.create_task(self._reap())

    @classmethod
    async def start(cls, *, stuck_s: float) -> "Worker":
        """Starts a child, and returns when it answers.

        Args:
            stuck_s: A child that leaves a call unanswered for so long hangs, and is killed.

        Raises:
            WorkerLost: It died before it answered.
        """
        ours, theirs = socket.socketpair()
        with theirs:
            process = _spawn(theirs)
        _, connection = await asyncio.get_running_loop().create_connection(Connection, sock=ours)
        worker = cls(process, connection, stuck_s=stuck_s)
        await worker._call(ListTasksRequest(), ListTasksResponse, within_s=_START_S)
        return worker

    @property
    def pid(self) -> int:
        """The id of its process."""
        return self._process.pid

    @property
    def is_lost(self) -> bool:
        """Whether it is dead."""
        return self._connection.lost.is_set()

    async def call(self, request: object, response: type[Response]) -> Response:
        """Asks the child. When the caller is cancelled, the child does what was asked all the same.

        Args:
            request: A request of `protocol.CALLS`.
            response: What answers it.

        Raises:
            WorkerLost: The child is dead, or hung and was killed.
            ServiceError: The child refused.
        """
        return await self._call(request, response, within_s=self._stuck_s)

    async def wait_ended(self) -> None:
        """Returns when the child has exited."""
        await asyncio.shield(self._reaping)

    async def close(self) -> None:
        """Ends the child: it exits when its socket closes, or is killed."""
        self._connection.close()
        await self.wait_ended()

    async def _call(self, request: object, response: type[Response], *, within_s: float) -> Response:
        try:
            async with asyncio.timeout(within_s):
                message = await self._connection.ask(request)
        except TimeoutError:
            _LOG.error("worker %d hangs and is killed", self._process.pid)
            self._process.kill()
            raise worker_lost() from None
        return protocol.decode(message, response)

    async def _reap(self) -> None:
        await self._connection.lost.wait()
        try:
            status = await asyncio.to_thread(self._process.wait, _EXIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            status = await asyncio.to_thread(self._process.wait)
        _LOG.log(logging.ERROR if status else logging.INFO, "worker %d ended with %d", self._process.pid, status)


def _spawn(connection: socket.socket) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        [sys.executable, "-m", "freerein_sim.workers", str(connection.fileno())],
        pass_fds=[connection.fileno()],
        stdin=subprocess.DEVNULL,
        env=_ONE_THREAD | os.environ,
    )
