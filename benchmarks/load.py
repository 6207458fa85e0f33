"""Robots that do not wait, in a process of their own: each sends its observations when they are due.

    python -m benchmarks.load < a Load, as msgpack > an Answered, as msgpack

Messages are made beforehand and replies are read as far as their number, so that little is measured but the server. A
latency counts from the moment at which an observation was due until it, or a newer one of its robot, is answered: a
server is rewarded neither for making its clients wait nor for answering few of them.
"""

import asyncio
import contextlib
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TypeAlias

import grpc
import msgpack  # type: ignore[import-untyped]
import uvloop

from freerein.api.imitation.v1 import imitation_pb2

_Call: TypeAlias = "grpc.aio.StreamStreamCall[bytes, bytes]"
_FIRST_S = 0.5
_LAST_S = 1.0


@dataclass(frozen=True)
class Load:
    """What to send, and how fast.

    Attributes:
        address: Where the server listens, `host:port`.
        method: The bidirectional gRPC method.
        hello: The first message of every stream.
        messages: What every stream sends after it, one after the other.
        seq_bytes: How many bytes of a reply are its number; 0 for a ControlResponse, whose Hello is answered, too.
        streams: Streams at once.
        rate_hz: Messages per second of each stream.
    """

    address: str
    method: str
    hello: bytes
    messages: list[bytes]
    seq_bytes: int
    streams: int
    rate_hz: float


@dataclass(frozen=True)
class Answered:
    """What came of a load.

    Attributes:
        seconds: For each message, from when it was due until it or one after it on its stream was answered; for those
            still waiting at the end, until then.
        share: How many were answered themselves.
    """

    seconds: list[float]
    share: float


async def run(load: Load) -> Answered:
    """Runs a load in a process of its own.

    Raises:
        RuntimeError: The process failed.
    """
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-m", __name__, stdin=pipe, stdout=pipe)
    output, _ = await process.communicate(msgpack.packb(asdict(load)))
    if process.returncode:
        raise RuntimeError(f"The clients must come to an end; they ended with {process.returncode}.")
    return Answered(**msgpack.unpackb(output))


def main() -> None:
    """Sends the load of the standard input."""
    load = Load(**msgpack.unpackb(sys.stdin.buffer.read()))
    sys.stdout.buffer.write(msgpack.packb(asdict(uvloop.run(_send(load)))))


async def _send(load: Load) -> Answered:
    async with grpc.aio.insecure_channel(load.address) as channel:
        calls: list[_Call] = [channel.stream_stream(load.method)() for _ in range(load.streams)]
        for call in calls:
            await call.write(load.hello)
            if not load.seq_bytes:
                await call.read()
        begin_s = time.perf_counter() + _FIRST_S
        starts_s = [begin_s + place / load.streams / load.rate_hz for place in range(load.streams)]
        robots = [_Robot(call, load, start_s) for call, start_s in zip(calls, starts_s, strict=True)]
        await asyncio.gather(*(robot.run() for robot in robots))
        for call in calls:
            call.cancel()
    seconds = [latency_s for robot in robots for latency_s in robot.latencies_s]
    return Answered(seconds, sum(robot.answers for robot in robots) / len(seconds))


class _Robot:
    def __init__(self, call: _Call, load: Load, start_s: float) -> None:
        self.latencies_s: list[float] = []
        self.answers = 0
        self._call = call
        self._load = load
        self._start_s = start_s
        self._number = _prefix(load.seq_bytes) if load.seq_bytes else _control_seq

    async def run(self) -> None:
        """Sends everything, and waits a moment for the last answers."""
        reading = asyncio.ensure_future(self._read())
        for seq, message in enumerate(self._load.messages):
            await asyncio.sleep(self._due_s(seq) - time.perf_counter())
            await self._call.write(message)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(reading, _LAST_S)
        self._settle(len(self._load.messages) - 1)

    async def _read(self) -> None:
        """Reads until the last message is answered; answers come in order."""
        while isinstance(reply := await self._call.read(), bytes):
            seq = self._number(reply)
            self._settle(seq)
            self.answers += 1
            if seq == len(self._load.messages) - 1:
                return

    def _settle(self, last: int) -> None:
        """Ends the waiting of all messages up to this one."""
        now_s = time.perf_counter()
        self.latencies_s += [now_s - self._due_s(seq) for seq in range(len(self.latencies_s), last + 1)]

    def _due_s(self, seq: int) -> float:
        return self._start_s + seq / self._load.rate_hz


def _prefix(size: int) -> Callable[[bytes], int]:
    return lambda reply: int.from_bytes(reply[:size], "little")


def _control_seq(reply: bytes) -> int:
    response = imitation_pb2.ControlResponse.FromString(reply)
    if not response.HasField("chunk"):
        raise RuntimeError("an observation was refused")
    return response.seq


if __name__ == "__main__":
    main()
