"""An open-loop load generator in its own process: robots send observations at a fixed rate.

    python -m benchmarks.load_generator < Load as msgpack > LoadResult as msgpack

Messages are prepared, and only the number of a reply is decoded. The latency of an observation is from its scheduled
time until the reply to it, or to a newer one of its robot: a server gains nothing by
delaying clients or skipping replies.
"""

import asyncio
import contextlib
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TypeAlias

import grpc
import msgpack
import uvloop

from freerein.api.imitation.v1 import imitation_pb2

_Call: TypeAlias = "grpc.aio.StreamStreamCall[bytes, bytes]"
_START_DELAY_S = 0.5
_LAST_REPLY_TIMEOUT_S = 1.0


@dataclass(frozen=True)
class Load:
    """A load: `streams` robots that each send `hello`, then `messages` at a rate, on a bidirectional gRPC method.

    Attributes:
        seq_bytes: Bytes of the number that begins a reply; 0 for a ControlResponse, whose server also answers Hello.
    """

    address: str
    method: str
    hello: bytes
    messages: list[bytes]
    seq_bytes: int
    streams: int
    rate_hz: float


@dataclass(frozen=True)
class LoadResult:
    """The replies to a load.

    Attributes:
        latencies_s: Latency of each message, in seconds; until the end of the run for unanswered ones.
        answered_share: Fraction of messages with a reply of their own.
    """

    latencies_s: list[float]
    answered_share: float


async def run(load: Load) -> LoadResult:
    """Runs a load in a separate process."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-m", __name__, stdin=pipe, stdout=pipe)
    output, _ = await process.communicate(msgpack.packb(asdict(load)))
    if process.returncode:
        raise RuntimeError(f"The load generator must succeed; it ended with exit code {process.returncode}.")
    return LoadResult(**msgpack.unpackb(output))


def main() -> None:
    """Runs the load from stdin."""
    load = Load(**msgpack.unpackb(sys.stdin.buffer.read()))
    sys.stdout.buffer.write(msgpack.packb(asdict(uvloop.run(_send(load)))))


async def _send(load: Load) -> LoadResult:
    async with grpc.aio.insecure_channel(load.address) as channel:
        calls: list[_Call] = [channel.stream_stream(load.method)() for _ in range(load.streams)]
        for call in calls:
            await call.write(load.hello)
            if not load.seq_bytes:
                await call.read()
        first_s = time.perf_counter() + _START_DELAY_S
        starts_s = [first_s + place / load.streams / load.rate_hz for place in range(load.streams)]
        robots = [_Robot(call, load, start_s) for call, start_s in zip(calls, starts_s, strict=True)]
        await asyncio.gather(*(robot.run() for robot in robots))
        for call in calls:
            call.cancel()
    latencies_s = [latency_s for robot in robots for latency_s in robot.latencies_s]
    return LoadResult(latencies_s, sum(robot.answers for robot in robots) / len(latencies_s))


class _Robot:
    def __init__(self, call: _Call, load: Load, start_s: float) -> None:
        self.latencies_s: list[float] = []
        self.answers = 0
        self._call = call
        self._load = load
        self._start_s = start_s
        self._number = _prefix(load.seq_bytes) if load.seq_bytes else _control_seq

    async def run(self) -> None:
        """Sends all messages, and waits for the last replies."""
        reading = asyncio.ensure_future(self._read())
        for seq, message in enumerate(self._load.messages):
            await asyncio.sleep(self._due_s(seq) - time.perf_counter())
            await self._call.write(message)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(reading, _LAST_REPLY_TIMEOUT_S)
        self._record_until(len(self._load.messages) - 1)

    async def _read(self) -> None:
        """Reads replies, which come in order, until the last message is answered."""
        while isinstance(reply := await self._call.read(), bytes):
            seq = self._number(reply)
            self._record_until(seq)
            self.answers += 1
            if seq == len(self._load.messages) - 1:
                return

    def _record_until(self, last: int) -> None:
        """Records the latency of all messages up to this number."""
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
