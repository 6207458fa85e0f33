"""gRPC messages that cost much to parse or never end, and floods of HTTP/2 frames: others are answered meanwhile."""

import math
import re
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from tests.faults import http2_client as http2

from freerein.serving.limits import MAX_VALUES, Limits

pytestmark = pytest.mark.e2e
SEGMENT = "/freerein.api.segmentation.v1.SegmentationService/Segment"
HEALTH = "/grpc.health.v1.Health/Check"
REFLECTION = "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo"
MIB = 2**20
RECEIPT_S = 3.0
OVERLOADED, LATE = "8", "4"
OPTIONS = (("grpc.max_send_message_length", -1), ("grpc.use_local_subchannel_pool", 1))


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty(FREEREIN_RECEIPT_S=str(RECEIPT_S))


@pytest.fixture
def channel(faulty: Any) -> Iterator[grpc.Channel]:
    with grpc.insecure_channel(faulty.service.address, OPTIONS) as channel:
        yield channel


def outcome(channel: grpc.Channel, message: bytes = b"") -> tuple[grpc.StatusCode, str]:
    """What becomes of a call of Segment; one without a trajectory is an invalid argument."""
    try:
        channel.unary_unary(SEGMENT)(message, timeout=60)
    except grpc.RpcError as error:
        return error.code(), error.details()
    return grpc.StatusCode.OK, ""


def is_healthy(channel: grpc.Channel) -> bool:
    reply = health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest(), timeout=60)
    return bool(reply.status == health_pb2.HealthCheckResponse.SERVING)


@contextmanager
def longest_health_check(address: str) -> Iterator[list[float]]:
    """Measures how long health checks take, in seconds; the longest is in the list when the block has ended.

    One that is refused counts as if its caller had waited for ever.
    """
    longest, done = [0.0], threading.Event()

    def check() -> None:
        with grpc.insecure_channel(address, OPTIONS) as channel:
            while not done.is_set():
                begun = time.perf_counter()
                try:
                    is_healthy(channel)
                except grpc.RpcError:
                    longest[0] = math.inf
                longest[0] = max(longest[0], time.perf_counter() - begun)

    checking = threading.Thread(target=check)
    checking.start()
    try:
        yield longest
    finally:
        done.set()
        checking.join()


def packed(numbers: int) -> bytes:
    """`frames.shape` of many numbers of one byte each."""
    shape = b"\x12" + length(numbers) + bytes(numbers)
    return b"\x12" + length(len(shape)) + shape


def length(number: int) -> bytes:
    parts = []
    while number >= 0x80:
        parts.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*parts, number])


# --- messages that cost much


@pytest.mark.fault("F2")
@pytest.mark.parametrize(
    "message",
    [b"\x1a\0" * (8 * MIB), packed(32 * MIB), b"\xa0\x06\x01" * (10 * MIB)],
    ids=["16 MiB of empty images", "32 MiB of packed numbers", "30 MiB of unknown fields"],
)
def test_a_message_of_many_values_is_refused_while_others_are_answered(
    faulty: Any, channel: grpc.Channel, message: bytes, least_of_many: Any
) -> None:
    before = faulty.process.memory_info().rss

    def measure() -> float:
        with longest_health_check(faulty.service.address) as longest:
            assert outcome(channel, message) == (
                grpc.StatusCode.INVALID_ARGUMENT,
                f"A message may hold at most {MAX_VALUES} values; got more.",
            )
        return longest[0]

    assert least_of_many(measure, below=2) < 2
    assert faulty.process.memory_info().rss - before < 2 * len(message) + 128 * MIB


# --- messages that never end


@pytest.mark.fault("F4")
def test_messages_that_never_end_hold_no_more_than_all_messages_may(
    faulty: Any, channel: grpc.Channel, wait_until: Any, least_of_many: Any
) -> None:
    size, most = 60 * MIB, Limits().slow_messages
    start = b"\0" + struct.pack(">I", size) + bytes(size - 1)
    quarter = len(start) // 4

    before = faulty.process.memory_info().rss

    def attack() -> int:
        """Returns how many calls had the place of one that was late: none when all came fast enough."""
        forget_peak(faulty.process.pid)
        with ExitStack() as connections:
            attackers = [connections.enter_context(http2.Http2(faulty.service.grpc_port)) for _ in range(most + 4)]
            calls = [(each, each.call(SEGMENT)) for each in attackers]
            send_all(calls, start[:quarter])  # in the first second every message may arrive
            wait_until(lambda: sum(call in each.ended for each, call in calls) >= 4, 60)
            send_all(calls, start[quarter:])
            ended = Counter(each.wait_for_end(call, 60) for each, call in calls)
        assert set(ended) <= {LATE, OVERLOADED}
        assert peak_bytes(faulty.process.pid) - before < Limits().buffered_bytes + 4 * quarter + 64 * MIB
        return 4 - ended[OVERLOADED]

    for _ in range(2):  # what a call held is free for the next
        assert least_of_many(attack, below=1) == 0
    assert outcome(channel)[0] == grpc.StatusCode.INVALID_ARGUMENT


def send_all(calls: list[tuple[Any, int]], payload: bytes) -> None:
    """Sends the same bytes on all calls that have not ended, at the same time."""
    senders = [threading.Thread(target=connection.data, args=(call, payload)) for connection, call in calls]
    for sender in senders:
        sender.start()
    for sender in senders:
        sender.join()


def forget_peak(pid: int) -> None:
    """Lets the measurement of a process's peak memory begin anew."""
    Path(f"/proc/{pid}/clear_refs").write_text("5")


def peak_bytes(pid: int) -> int:
    """Returns the most memory that a process had since then."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    assert found
    return int(found[1]) * 1024


@pytest.mark.fault("F4")
@pytest.mark.parametrize(
    ("path", "refusal"),
    [(SEGMENT, "At most 512 calls"), (REFLECTION, "At most 64 streams")],
    ids=["unary", "stream"],
)
def test_calls_without_a_message_keep_nobody_out_for_long(
    faulty: Any, channel: grpc.Channel, path: str, refusal: str, least_of_many: Any
) -> None:
    def attack() -> float:
        """Returns 0 when the calls came fast enough to take all places, and their deadlines passed one by one."""
        with ExitStack() as connections:
            attackers = [connections.enter_context(http2.Http2(faulty.service.grpc_port)) for _ in range(3)]
            calls = [(each, each.call(path)) for each in attackers for _ in range(Limits().concurrent_calls // 2)]
            assert is_healthy(channel)
            ended = [each.wait_for_end(call, 60) for each, call in calls]
            is_told = set(ended) <= {LATE, OVERLOADED} and any(refusal in each.messages[call] for each, call in calls)
            return 0 if is_told and ended.count(OVERLOADED) > 0.9 * len(ended) else 1

    assert least_of_many(attack, below=1) == 0
    assert outcome(channel)[0] == grpc.StatusCode.INVALID_ARGUMENT


@pytest.mark.fault("F4")
def test_health_checks_without_a_message_end_too(faulty: Any, channel: grpc.Channel, least_of_many: Any) -> None:
    def late() -> int:
        """Returns how many were not refused before their deadline; a busy machine lets more pass at once."""
        with http2.Http2(faulty.service.grpc_port) as connection:
            calls = [connection.call(HEALTH) for _ in range(Limits().health_calls + 1)]
            ended = [connection.wait_for_end(call, 60) for call in calls]
        assert set(ended) <= {OVERLOADED, LATE}
        return ended.count(LATE)

    most = Limits().slow_messages
    assert least_of_many(late, below=most + 1) <= most
    assert is_healthy(channel)


# --- floods of frames


def rapid_resets(connection: Any) -> Iterator[bytes]:
    while True:
        opened = http2.frame(http2.HEADERS, http2.END_HEADERS, connection.next_stream(), connection.headers(SEGMENT))
        yield opened + http2.frame(http2.RST_STREAM, 0, connection.last_stream, struct.pack(">I", 8))


def repeated(kind: str, payload: bytes) -> Callable[[Any, Any], Iterator[bytes]]:
    def frames(_connection: Any) -> Iterator[bytes]:
        while True:
            yield http2.frame(getattr(http2, kind), 0, 0, payload)

    return frames


def endless_headers(connection: Any) -> Iterator[bytes]:
    yield http2.frame(http2.HEADERS, 0, connection.next_stream(), connection.headers(SEGMENT))
    while True:
        yield http2.frame(http2.CONTINUATION, 0, connection.last_stream, b"\0\x01a\x01b" * 1000)


@pytest.mark.fault("N6")
@pytest.mark.parametrize(
    "flood",
    [rapid_resets, repeated("PING", bytes(8)), repeated("SETTINGS", struct.pack(">HI", 4, 65535)), endless_headers],
    ids=["rapid resets", "pings", "settings", "continuations"],
)
def test_a_flood_of_frames_keeps_nobody_else_waiting(
    faulty: Any, channel: grpc.Channel, flood: Any, repeats: int
) -> None:
    before = faulty.process.memory_info().rss
    with flooding(faulty.service.grpc_port, flood):
        assert all(is_healthy(channel) for _ in range(20 * repeats))
    assert faulty.process.memory_info().rss - before < 256 * MIB


@contextmanager
def flooding(port: int, flood: Any) -> Iterator[None]:
    """Sends frames until the block ends, on a new connection whenever the server closes one."""
    done = threading.Event()

    def attack() -> None:
        while not done.is_set():
            with http2.Http2(port) as attacker:
                frames = flood(attacker)
                while not (attacker.closed or done.is_set()):
                    attacker.send(next(frames))

    attacking = threading.Thread(target=attack)
    attacking.start()
    try:
        yield
    finally:
        done.set()
        attacking.join()
