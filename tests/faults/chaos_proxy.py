"""A bad network between a client and a service: a TCP proxy that delays, throttles, splits, stalls, breaks and refuses.

TCP hides loss, reordering and duplicates from whoever reads a socket; what is left of them up here is delay, which this
makes.
"""

import asyncio
import random
import socket
import struct
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self, TypeAlias

_BLOCK = 1 << 16
_IN_FLIGHT = 64  # blocks; more than these push back, as a full socket buffer does
_RESET = struct.pack("ii", 1, 0)  # close with RST, not FIN
_Blocks: TypeAlias = "asyncio.Queue[tuple[float, bytes]]"


@dataclass(frozen=True)
class Weather:
    """What the network does to what passes.

    Attributes:
        delay_s: Of every block, one way.
        jitter_s: At most this much is added to the delay or taken off it, anew for each block; none overtakes another.
        bytes_per_s: Each way of each connection; 0 for no limit.
        segment: Bytes that are sent at once; 0 for as they came.
        resets_after: Bytes of replies after which a connection is reset, wherever in a message that is; 0 for never.
    """

    delay_s: float = 0.0
    jitter_s: float = 0.0
    bytes_per_s: float = 0.0
    segment: int = 0
    resets_after: int = 0


@dataclass(eq=False)
class _Way:
    """One way of a connection: what is on it, and where it leads."""

    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    are_replies: bool
    passed: int = 0
    blocks: _Blocks = field(default_factory=lambda: asyncio.Queue(_IN_FLIGHT))

    def reset(self) -> None:
        with suppress(OSError):
            self.writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
        self.writer.transport.abort()


class ChaosProxy:
    """Listens on a port of its own while `async with` lasts, and passes on to a service what comes.

    Args:
        target: The service, `host:port`.
        weather: At first.
        seed: Of the jitter.

    Attributes:
        address: Where clients connect, `host:port`.
        weather: What happens to what passes from now on; may be set at any time.
        connections: How many there have been.
    """

    def __init__(self, target: str, weather: Weather = Weather(), *, seed: int = 0) -> None:
        self.weather = weather
        self.address = ""
        self.connections = 0
        self._host, _, self._port = target.rpartition(":")
        self._rng = random.Random(seed)
        self._ways: list[_Way] = []
        self._serving: set[asyncio.Task[None]] = set()
        self._refuses = False
        self._whole = asyncio.Event()

    def reset(self) -> None:
        """Resets every connection."""
        for way in self._ways:
            way.reset()

    def half_close(self) -> None:
        """Tells the service that its clients will say no more; replies go on."""
        for way in self._ways:
            if not way.are_replies:
                way.blocks.put_nowait((0.0, b""))

    def partition(self) -> None:
        """Lets nothing pass, silently: connections stay open, new ones open, and nobody answers."""
        self._whole.clear()

    def refuse(self) -> None:
        """Resets every connection, and every new one."""
        self._refuses = True
        self.reset()

    def heal(self) -> None:
        """Ends partitions and refusals."""
        self._refuses = False
        self._whole.set()

    async def __aenter__(self) -> Self:
        self.heal()
        self._server = await asyncio.start_server(self._accept, "127.0.0.1", 0)
        self.address = f"127.0.0.1:{self._server.sockets[0].getsockname()[1]}"
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._server.close()
        for serving in self._serving:
            serving.cancel()
        await asyncio.gather(*self._serving, return_exceptions=True)

    async def _accept(self, requests: asyncio.StreamReader, client: asyncio.StreamWriter) -> None:
        self.connections += 1
        serving = asyncio.create_task(self._serve(requests, client))
        self._serving.add(serving)
        serving.add_done_callback(self._serving.discard)

    async def _serve(self, requests: asyncio.StreamReader, client: asyncio.StreamWriter) -> None:
        ways = [_Way(requests, client, are_replies=True)]
        try:
            await self._whole.wait()
            if not self._refuses:
                replies, service = await asyncio.open_connection(self._host, int(self._port))
                ways = [_Way(requests, service, are_replies=False), _Way(replies, client, are_replies=True)]
                self._ways += ways
                async with asyncio.TaskGroup() as both:
                    for way in ways:
                        both.create_task(self._arrive(way))
                        both.create_task(self._depart(way))
        except* OSError:  # one side broke it off, or was never there: the other side is told in the end
            await self._whole.wait()
        finally:
            for way in ways:
                way.reset()
            self._ways = [way for way in self._ways if way not in ways]

    async def _arrive(self, way: _Way) -> None:
        data = b"-"
        while data:
            data = await way.reader.read(_BLOCK)
            late_s = self.weather.delay_s + self._rng.uniform(-1, 1) * self.weather.jitter_s
            await way.blocks.put((asyncio.get_running_loop().time() + late_s, data))

    async def _depart(self, way: _Way) -> None:
        data = b"-"
        while data:
            due_s, data = await way.blocks.get()
            await asyncio.sleep(due_s - asyncio.get_running_loop().time())
            await self._whole.wait()
            size = self.weather.segment or max(1, len(data))
            for start in range(0, len(data), size):
                await self._send(way, data[start : start + size])
        way.writer.write_eof()

    async def _send(self, way: _Way, segment: bytes) -> None:
        await self._whole.wait()
        way.writer.write(segment)
        await way.writer.drain()
        way.passed += len(segment)
        if way.are_replies and 0 < self.weather.resets_after <= way.passed:
            raise ConnectionResetError
        if self.weather.bytes_per_s:
            await asyncio.sleep(len(segment) / self.weather.bytes_per_s)
