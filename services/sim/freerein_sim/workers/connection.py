"""The service's end of the socket to a worker. Replies are received into the very buffer that they are parsed from."""

import asyncio
from typing import cast

from freerein.errors import WorkerLost
from freerein.types.common import Error
from freerein_sim.workers import protocol


class Connection(asyncio.BufferedProtocol):
    """Calls in flight, by number, and the frame being received.

    Attributes:
        lost: Set when the other end is gone.
    """

    def __init__(self) -> None:
        self.lost = asyncio.Event()
        self._calls: dict[int, asyncio.Future[bytearray]] = {}
        self._asked = 0
        self._header: protocol.Header | None = None
        self._buffer = bytearray(protocol.HEADER_BYTES)
        self._received = 0

    async def ask(self, request: object) -> bytearray:
        """Returns the bytes of the message that answers a request.

        Raises:
            WorkerLost: The other end is gone.
            ServiceError: It refused.
        """
        self._asked += 1
        number = self._asked
        frame = protocol.encode(request, call=protocol.call_of(request), number=number)
        if self.lost.is_set():
            raise worker_lost()
        answer: asyncio.Future[bytearray] = asyncio.get_running_loop().create_future()
        self._calls[number] = answer
        self._transport.writelines(frame)
        try:
            return await answer
        finally:
            del self._calls[number]

    def close(self) -> None:
        """Closes this end; the child takes it as the wish to exit."""
        self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keeps the transport."""
        self._transport = cast(asyncio.Transport, transport)

    def get_buffer(self, sizehint: int) -> memoryview:
        """Returns where to put what comes next: the rest of the header, or of the message."""
        return memoryview(self._buffer)[self._received :]

    def buffer_updated(self, nbytes: int) -> None:
        """Goes from header to message, and from message to header."""
        self._received += nbytes
        while self._received == len(self._buffer):
            self._received = 0
            if self._header is None:
                self._begin_message()
            else:
                self._end_message(self._header)

    def connection_lost(self, exc: Exception | None) -> None:
        """Fails the calls in flight."""
        self.lost.set()
        for answer in self._calls.values():
            if not answer.done():
                answer.set_exception(worker_lost())

    def _begin_message(self) -> None:
        self._header = protocol.decode_header(self._buffer)  # asyncio ends a connection whose protocol raises
        self._buffer = bytearray(self._header.length)

    def _end_message(self, header: protocol.Header) -> None:
        message, self._buffer, self._header = self._buffer, bytearray(protocol.HEADER_BYTES), None
        answer = self._calls.get(header.number)
        if answer is None or answer.done():
            return  # whoever asked was cancelled
        if header.call == protocol.REFUSED:
            answer.set_exception(protocol.error_from(protocol.decode(message, Error)))
        else:
            answer.set_result(message)


def worker_lost() -> WorkerLost:
    """Returns what callers of a dead worker are told."""
    return WorkerLost(
        "The process that held the session is gone.", hint="Create the session anew and restore its last snapshot."
    )
