"""A worker process as the service sees it: a child process, and calls over a socket pair.

Replies are received into the buffer that they are parsed from.
"""

import asyncio
import logging
import math
import os
import signal
import socket
import subprocess
from typing import TypeVar, cast

from freerein.errors import WorkerLost
from freerein.fork_server import ChildProcess, Program, StartChild
from freerein.types.common import Error, error_from
from freerein.types.sim import ListTasksRequest, ListTasksResponse, Task
from freerein_sim.workers import protocol

_LOG = logging.getLogger(__name__)
_START_S = 60.0
_EXIT_S = 1.0
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "0"}
"""Defaults for BLAS and Mesa. 0 means that Mesa renders on the calling thread, which is faster."""

Response = TypeVar("Response")


class Worker:
    """A child process that holds sessions. When it dies, its calls raise `WorkerLost`.

    Attributes:
        load: Number of environments placed on it, maintained by the caller.
        tasks: The tasks that it has environments of.
    """

    def __init__(self, process: ChildProcess, connection: "Connection", *, stuck_s: float) -> None:
        self.load = 0
        self.tasks: tuple[Task, ...] = ()
        self._process = process
        self._connection = connection
        self._stuck_s = stuck_s
        self._reaping = asyncio.create_task(self._reap())

    @classmethod
    async def start(cls, start_child: StartChild, *, stuck_s: float) -> "Worker":
        """Starts a child by `start_child`, and returns when it answers; a call that is cancelled ends it.

        Raises:
            WorkerLost: It died before.
        """
        ours, theirs = socket.socketpair()
        with theirs:
            _, connection = await asyncio.get_running_loop().create_connection(Connection, sock=ours)
            environ = _ONE_THREAD | os.environ
            process = start_child(Program("freerein_sim.workers", (), environ, theirs.fileno(), 1, 2))
        worker = cls(process, connection, stuck_s=stuck_s)
        try:
            listed = await worker.call(ListTasksRequest(), ListTasksResponse, timeout_s=_START_S)
        except asyncio.CancelledError:
            await worker.close()
            raise
        worker.tasks = tuple(listed.tasks)
        return worker

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def is_lost(self) -> bool:
        """Whether the process has died."""
        return self._connection.lost.is_set()

    async def call(self, request: object, response: type[Response], *, timeout_s: float | None = None) -> Response:
        """Sends a request and returns the response. The child completes it even if the caller is cancelled.

        A child that replies to nobody for `timeout_s` (None: the worker's `stuck_s`) is killed. Calls that wait behind
        others are no sign that it hangs: the time begins anew with each reply.

        Raises:
            WorkerLost: The child died, or hung and was killed.
            ServiceError: The child refused the request.
        """
        try:
            message = await self._connection.ask(request, silence_s=timeout_s or self._stuck_s)
        except TimeoutError:
            _LOG.error("worker %d hangs and is killed", self._process.pid)
            self._process.send_signal(signal.SIGKILL)
            raise worker_lost() from None
        return protocol.decode(message, response)

    async def wait_ended(self) -> None:
        """Returns when the child has exited."""
        await asyncio.shield(self._reaping)

    async def close(self) -> None:
        """Stops the child: it exits when its socket closes, or is killed."""
        self._connection.close()
        await self.wait_ended()

    async def _reap(self) -> None:
        await self._connection.lost.wait()
        try:
            status = await asyncio.to_thread(self._process.wait, _EXIT_S)
        except subprocess.TimeoutExpired:
            self._process.send_signal(signal.SIGKILL)
            status = await asyncio.to_thread(self._process.wait)
        _LOG.log(logging.ERROR if status else logging.INFO, "worker %d ended with %d", self._process.pid, status)


class Connection(asyncio.BufferedProtocol):
    """The service's end of the socket: calls in flight by number, and the frame being received."""

    def __init__(self) -> None:
        self.lost = asyncio.Event()
        self._calls: dict[int, asyncio.Future[bytearray]] = {}
        self._asked = 0
        self._replied_at = -math.inf
        self._header: protocol.Header | None = None
        self._buffer = bytearray(protocol.HEADER_BYTES)
        self._received = 0

    async def ask(self, request: object, *, silence_s: float) -> bytearray:
        """Sends a request and returns the bytes of the response.

        Raises:
            WorkerLost: The child died.
            TimeoutError: The child replied to no call for `silence_s`.
            ServiceError: The child refused the request.
        """
        self._asked += 1
        number = self._asked
        frame = protocol.encode(request, call=protocol.CALLS.index(type(request)), number=number)
        if self.lost.is_set() or self._transport.is_closing():  # from Python 3.12 on, writing would raise a TypeError
            raise worker_lost()
        answer: asyncio.Future[bytearray] = asyncio.get_running_loop().create_future()
        self._calls[number] = answer
        self._transport.writelines(frame)
        try:
            await self._wait(answer, silence_s)
            return answer.result()
        finally:
            del self._calls[number]

    def close(self) -> None:
        """Closes this end, on which the child exits."""
        self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Stores the transport."""
        self._transport = cast(asyncio.Transport, transport)

    def get_buffer(self, sizehint: int) -> memoryview:
        """Returns the rest of the buffer of the current header or message."""
        return memoryview(self._buffer)[self._received :]

    def buffer_updated(self, nbytes: int) -> None:
        """Switches between header and message."""
        self._received += nbytes
        while self._received == len(self._buffer):
            self._received = 0
            if self._header is None:
                self._header = protocol.decode_header(self._buffer)  # asyncio ends a connection whose protocol raises
                self._buffer = bytearray(self._header.length)
            else:
                self._end_message(self._header)

    def connection_lost(self, exc: Exception | None) -> None:
        """Fails the calls in flight."""
        self.lost.set()
        for answer in self._calls.values():
            if not answer.done():
                answer.set_exception(worker_lost())

    async def _wait(self, answer: "asyncio.Future[bytearray]", silence_s: float) -> None:
        """Waits for an answer. Raises TimeoutError after `silence_s` without a reply to this call or another."""
        loop = asyncio.get_running_loop()
        asked_at = loop.time()
        while not answer.done():
            left_s = max(asked_at, self._replied_at) + silence_s - loop.time()
            if left_s <= 0:
                raise TimeoutError
            await asyncio.wait({answer}, timeout=left_s)

    def _end_message(self, header: protocol.Header) -> None:
        self._replied_at = asyncio.get_running_loop().time()
        message, self._buffer, self._header = self._buffer, bytearray(protocol.HEADER_BYTES), None
        answer = self._calls.get(header.number)
        if answer is None or answer.done():
            return  # the caller was cancelled
        if header.call == protocol.REFUSED:
            answer.set_exception(error_from(protocol.decode(message, Error)))
        else:
            answer.set_result(message)


def worker_lost() -> WorkerLost:
    """Returns the error for calls of a dead worker."""
    return WorkerLost(
        "The worker process is gone, and with it the sessions that it held.",
        hint="Create the session anew and restore its last snapshot; repeat a call that needs none.",
    )
