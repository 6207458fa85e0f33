"""Control streams whose robot vanishes or does not read, or whose service hangs."""

import asyncio
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import grpc
import pytest
from tests.faults import control_robot as robots

from freerein import wire
from freerein.clients import Channel, ImitationClient

pytestmark = pytest.mark.e2e
CONTROL = "/freerein.api.imitation.v1.ImitationService/Control"
SERVER_KEEPALIVE_S = 10.0
WRITE_S = 3.0
SMALL_WINDOW = (("grpc.http2.lookahead_bytes", 1024), ("grpc.http2.bdp_probe", 0))
UNREAD = 1_500  # replies of 300 bytes: many times what the client's window holds
ROBOT = """
import sys, threading, grpc

def hello():
    yield bytes.fromhex(sys.argv[3])
    threading.Event().wait()

for _ in grpc.insecure_channel(sys.argv[1]).stream_stream(sys.argv[2])(hello()):
    print("open", flush=True)
"""


@pytest.fixture(scope="module")
def faulty(start_policy: Callable[..., Any]) -> Any:
    return start_policy(FREEREIN_WRITE_S="600")


@pytest.fixture(scope="module")
def impatient(start_policy: Callable[..., Any]) -> Any:
    return start_policy(FREEREIN_WRITE_S=str(WRITE_S))


@pytest.fixture(scope="module", autouse=True)
def abandoned(start_policy: Callable[..., Any]) -> Iterator[Any]:
    """A service whose robot's process was stopped: its connection stays open, and nobody answers pings.

    It comes first, so that the other tests take place while the service waits.
    """
    faulty = start_policy()
    hello = wire.pack(robots.hello()).SerializeToString().hex()
    command = [sys.executable, "-c", ROBOT, faulty.service.address, CONTROL, hello]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as robot:
        assert robot.stdout is not None
        assert robot.stdout.readline() == b"open\n"
        robot.send_signal(signal.SIGSTOP)
        yield faulty
        robot.kill()


def streams(faulty: Any) -> int:
    return int(faulty.metric('freerein_calls_in_flight{protocol="grpc"}'))


@pytest.mark.fault("I6")
async def test_a_robot_that_does_not_read_delays_only_itself_and_fills_no_memory(faulty: Any) -> None:
    before = faulty.process.memory_info().rss
    async with (
        grpc.aio.insecure_channel(faulty.service.address, SMALL_WINDOW) as channel,
        ImitationClient(Channel(faulty.service.address)) as client,
    ):
        deaf, listening = channel.stream_stream(CONTROL)(), robots.Stream(client.control)
        await deaf.write(wire.pack(robots.hello()).SerializeToString())
        assert await deaf.read()
        again = wire.pack(robots.seen(0)).SerializeToString()  # all but the first are answered by an error
        sending = asyncio.create_task(send(deaf, [again] * UNREAD))
        await listening.ask(robots.hello())
        seconds = []
        for seq in range(100):
            begun = time.perf_counter()
            assert (await listening.ask(robots.seen(seq))).chunk is not None
            seconds.append(time.perf_counter() - begun)
        assert sorted(seconds)[50] < 1  # 5 ms on an idle machine
        assert streams(faulty) == 2
        assert faulty.process.memory_info().rss - before < 16 * 2**20
        replies = [await deaf.read() for _ in range(UNREAD)]
        assert all(isinstance(reply, bytes) for reply in replies)  # it reads again, and nothing was lost
        await sending
        await listening.leave()


@pytest.mark.fault("I6")
@pytest.mark.parametrize("reads_late", [True, False])
async def test_a_robot_that_leaves_a_reply_unread_loses_its_stream(
    impatient: Any, wait_until: Any, *, reads_late: bool
) -> None:
    hello, again = (wire.pack(each).SerializeToString() for each in (robots.hello(), robots.seen(0)))
    with grpc.insecure_channel(
        impatient.service.address, SMALL_WINDOW
    ) as channel:  # of grpc.aio a failed write hides why
        deaf = channel.stream_stream(CONTROL)(iter([hello, *[again] * UNREAD]))
        assert await asyncio.to_thread(next, deaf)
        if not reads_late:
            await asyncio.to_thread(wait_until, lambda: not streams(impatient), 60)
        else:
            await asyncio.sleep(1.5 * WRITE_S)
            assert streams(impatient)
            with pytest.raises(grpc.RpcError):
                await asyncio.wait_for(asyncio.to_thread(list, deaf), 60)
            assert deaf.code() is grpc.StatusCode.DEADLINE_EXCEEDED
        deaf.cancel()


async def send(call: Any, messages: list[bytes]) -> None:
    for message in messages:
        await call.write(message)


@pytest.mark.fault("I9")
def test_a_service_that_hangs_is_noticed_soon(faulty: Any, least_of_many: Any) -> None:
    assert least_of_many(lambda: asyncio.run(seconds_until_noticed(faulty)), below=5) < 5  # 2 s, and a bit


async def seconds_until_noticed(faulty: Any) -> float:
    async with ImitationClient(Channel(faulty.service.address, keepalive_s=1.0)) as client:
        call = client.channel.grpc.stream_stream(CONTROL)()
        await call.write(wire.pack(robots.hello()).SerializeToString())
        assert await call.read()
        begun = time.monotonic()
        faulty.service.process.send_signal(signal.SIGSTOP)
        try:
            with pytest.raises(grpc.aio.AioRpcError) as noticed:
                await asyncio.wait_for(call.read(), 60)
        finally:
            faulty.service.process.send_signal(signal.SIGCONT)
    assert noticed.value.code() is grpc.StatusCode.UNAVAILABLE
    return time.monotonic() - begun


@pytest.mark.fault("I10")
def test_a_robot_that_vanishes_frees_its_stream(abandoned: Any, wait_until: Any) -> None:
    wait_until(lambda: not streams(abandoned), 10 * SERVER_KEEPALIVE_S)
