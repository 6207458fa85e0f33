"""The robots' WebSocket: bad messages, limits, tokens, silence, and the drain."""

import base64
import os
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import msgpack
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from freerein_imitation.openpi.messages import pack, unpack

pytestmark = pytest.mark.e2e
TOKEN = "correct-horse-battery"
BEARER = {"Authorization": f"Bearer {TOKEN}"}
RECEIPT_S = 5.0
IDLE_S = 5.0
WRITE_S = 1.0
PING_S = 10.0
MAX_BYTES = 8 * 2**20
MAX_FRAGMENTS = 1024
STREAMS = 64
GOAL = 200
CODES = ("malformed_request", "invalid_input", "model_fault", "output_not_finite")


@pytest.fixture(scope="module")
def faulty(start_policy: Callable[..., Any]) -> Any:
    return start_policy()


@pytest.fixture(scope="module")
def strict(start_policy: Callable[..., Any]) -> Any:
    return start_policy(
        FREEREIN_TOKEN=TOKEN,
        FREEREIN_CORS_ORIGINS="https://robots.example",
        FREEREIN_RECEIPT_S=str(RECEIPT_S),
        FREEREIN_IDLE_S=str(IDLE_S),
        FREEREIN_WRITE_S=str(WRITE_S),
    )


@pytest.fixture(scope="module", autouse=True)
def abandoned(start_policy: Callable[..., Any]) -> Iterator[tuple[Any, float]]:
    """A service whose robot answers no pings, and since when; the other tests take place while it waits."""
    faulty = start_policy()
    with raw_connection(faulty):
        yield faulty, time.monotonic()


@pytest.fixture
def robot(faulty: Any) -> Iterator[ClientConnection]:
    """A connection, after the metadata."""
    with robot_of(faulty) as connection:
        yield connection


@contextmanager
def robot_of(faulty: Any, query: str = "", **options: Any) -> Iterator[ClientConnection]:
    with connect(
        f"ws://127.0.0.1:{faulty.service.http_port}/{query}", compression=None, open_timeout=60, **options
    ) as connection:
        connection.recv(60)
        yield connection


def raw_connection(faulty: Any, token: str = "") -> socket.socket:
    """Returns a connection after the handshake that nobody reads, and on which pings are not answered."""
    connection: socket.socket = faulty.connect()
    key = base64.b64encode(os.urandom(16)).decode()
    headers = ["Host: localhost", "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
    headers += [f"Sec-WebSocket-Key: {key}", f"Authorization: Bearer {token}"]
    connection.sendall("\r\n".join(["GET / HTTP/1.1", *headers, "", ""]).encode())
    assert connection.recv(4096).startswith(b"HTTP/1.1 101 ")
    return connection


def frame(opcode: int, payload: bytes, *, is_last: bool = True) -> bytes:
    """Returns a frame of a client, masked by zeros."""
    size = len(payload)
    length = bytes([0x80 | size]) if size < 126 else struct.pack("!BH", 0x80 | 126, size)
    return bytes([is_last << 7 | opcode]) + length + bytes(4) + payload


def pixels(brightness: int, *, fault: int = 0, hundredths: int = 0) -> "np.ndarray[Any, Any]":
    image = np.zeros((4, 4, 3), np.uint8)
    image[0, 0] = fault, hundredths, brightness
    return image


def seen(brightness: int = 0, *, goal: int = GOAL, **changes: Any) -> dict[str, Any]:
    asked = {key: changes.pop(key) for key in ("fault", "hundredths") if key in changes}
    return {"observation/front": pixels(brightness, **asked), "goal/front": pixels(goal), **changes}


def ask(robot: ClientConnection, message: dict[str, Any]) -> Any:
    robot.send(pack(message))
    reply = robot.recv(60)
    return reply if isinstance(reply, str) else unpack(reply)


def packed(**values: Any) -> bytes:
    """Returns a good message with these values in place of its own."""
    data: bytes = msgpack.packb({**unpacked(seen()), **values})
    return data


def unpacked(message: dict[str, Any]) -> dict[str, Any]:
    return dict(msgpack.unpackb(pack(message)))


def array(**changes: Any) -> dict[bytes, Any]:
    """Returns an image as openpi packs it, with changes."""
    good = {b"__ndarray__": True, b"data": bytes(48), b"dtype": "|u1", b"shape": (4, 4, 3)}
    return {**good, **{key.encode(): value for key, value in changes.items()}}


BAD = {
    "no bytes": b"",
    "no msgpack": b"\xc1",
    "cut": packed()[:-1],
    "more than one": packed() * 2,
    "no map": msgpack.packb([1]),
    "keys of bytes": msgpack.packb({b"reset": True}),
    "keys of numbers": msgpack.packb({1: 2}),
    "a key twice": b"\x82\xa5reset\xc2\xa5reset\xc3",
    "deep": b"\x91" * 600 + b"\xc0",
    "wide": packed(recipe=[0] * 300_000),
    "nested and wide": packed(recipe=[[[0] * 1000] * 1000]),
    "a pickle": packed(**{"observation/front": array(dtype="|O")}),
    "complex numbers": packed(**{"observation/front": array(dtype="<c8")}),
    "records": packed(**{"observation/front": array(dtype="|V3")}),
    "big-endian": packed(**{"observation/front": array(dtype=">f4")}),
    "a dtype of bytes": packed(**{"observation/front": array(dtype=b"|u1")}),
    "a huge shape": packed(**{"observation/front": array(shape=(2**62, 2**62, 3))}),
    "a negative shape": packed(**{"observation/front": array(shape=(-4, -4, 3))}),
    "a shape of booleans": packed(**{"observation/front": array(shape=(True, 4, 12))}),
    "too few bytes": packed(**{"observation/front": array(data=bytes(47))}),
    "data of text": packed(**{"observation/front": array(data="0" * 48)}),
    "an extension": packed(recipe=msgpack.ExtType(5, b"12")),
    "a time": packed(recipe=msgpack.Timestamp(1)),
    "text that is no UTF-8": b"\x81\xa6prompt\xa1\xff",
    "floats as image": packed(**{"observation/front": array(dtype="<f4", shape=(4, 3))}),
    "channels first": packed(**{"observation/front": array(shape=(3, 4, 4))}),
    "a sequence of observations": packed(**{"observation/front": array(shape=(1, 4, 4, 3))}),
    "no goals": packed(**{"goal/front": array(shape=(0, 4, 4, 3), data=b"")}),
    "an unknown key": packed(state=b""),
    "another form of goal": packed(recipe=["go"]),
    "actions of another shape": packed(executed_actions=array(dtype="<f4", shape=(4, 3))),
    "actions of another type": packed(executed_actions=[0.5, 0.5]),
    "a flag of another type": packed(reset=1),
    "a state that is no array": packed(**{"observation/state": [0.5, 0.5]}),
}


@pytest.mark.fault("I19")
def test_a_bad_message_is_refused_and_the_next_one_is_answered(robot: ClientConnection) -> None:
    for name, message in BAD.items():
        robot.send(message)
        refusal = robot.recv(60)
        assert isinstance(refusal, str), name
        assert refusal.startswith(("malformed_request: ", "invalid_input: ")), name
        assert len(refusal) < 1024, name
        assert ask(robot, seen(GOAL, reset=True))["goal_reached"], name


@pytest.mark.fault("I19")
def test_a_text_is_refused(robot: ClientConnection) -> None:
    robot.send("hello")
    assert str(robot.recv(60)).startswith("malformed_request: ")


@pytest.mark.fault("I19")
def test_random_messages_are_refused(robot: ClientConnection, fuzz: bool) -> None:
    rng, good = np.random.default_rng(0), packed()
    for _ in range(20_000 if fuzz else 300):
        changed = bytearray(good)
        for place in rng.integers(len(good), size=rng.integers(1, 5)):
            values = rng.integers(
                16, 256, size=rng.choice((1, 1, 1, 0, 2))
            )  # less than 16 asks for a fault, such as to hang
            changed[place : place + rng.choice((1, 1, 1, 0, 2))] = bytes(values.tolist())
        robot.send(bytes(changed))
        reply = robot.recv(60)
        assert not isinstance(reply, str) or reply.partition(": ")[0] in CODES
    assert ask(robot, seen(GOAL))["goal_reached"]


@pytest.mark.fault("I19")
@pytest.mark.parametrize(("fault", "code"), [(1, "model_fault"), (2, "output_not_finite"), (4, "output_not_finite")])
def test_a_fault_of_the_model_is_told_and_changes_nothing(faulty: Any, fault: int, code: str) -> None:
    with robot_of(faulty) as robot, robot_of(faulty) as other:
        assert ask(robot, seen(1))["goal_index"] == ask(other, seen(1))["goal_index"]
        assert ask(robot, seen(2, fault=fault)).startswith(f"{code}: ")
        done = np.full((1, 2), 0.5, np.float32)
        replies = [ask(each, seen(3, executed_actions=done)) for each in (robot, other)]
        np.testing.assert_array_equal(*(reply["actions"] for reply in replies))


@pytest.mark.parametrize(
    ("query", "code"),
    [
        ("?model.name=../..", "invalid_input"),
        ("?model.name=default&model.version=../../..", "invalid_input"),
        ("?model.name=nobody", "failed_precondition"),
        ("?model=default", "invalid_input"),
        ("?model.name=default&model.name=default", "invalid_input"),
        ("?max_steps_per_goal=-1", "invalid_input"),
        ("?max_steps_per_goal=99999999999", "invalid_input"),
        ("?action_horizon=two", "invalid_input"),
        ("?goal.text=go", "invalid_input"),
        ("?goal.recipe=go", "invalid_input"),
    ],
)
def test_a_bad_url_is_refused_with_its_reason(faulty: Any, query: str, code: str) -> None:
    with pytest.raises(ConnectionClosed) as error, robot_of(faulty, query):
        pass
    assert error.value.rcvd is not None
    assert error.value.rcvd.code == 1008
    assert error.value.rcvd.reason.startswith(f"{code}: ")


@pytest.mark.fault("C13")
@pytest.mark.parametrize("authorization", [None, "Bearer wrong", "Api-Key wrong", f"Basic {TOKEN}", TOKEN])
def test_a_robot_without_the_token_is_refused_with_a_problem_document(strict: Any, authorization: str | None) -> None:
    headers = {"Authorization": authorization} if authorization else {}
    with pytest.raises(InvalidStatus) as error, robot_of(strict, additional_headers=headers):
        pass
    assert error.value.response.status_code == 401
    assert error.value.response.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("scheme", ["Bearer", "Api-Key"])
def test_a_robot_shows_the_token_as_openpis_client_does_too(strict: Any, scheme: str) -> None:
    with robot_of(strict, additional_headers={"Authorization": f"{scheme} {TOKEN}"}) as robot:
        assert ask(robot, seen(GOAL))["goal_reached"]


def test_a_web_page_of_an_origin_that_is_allowed_may_connect(strict: Any) -> None:
    with robot_of(strict, origin="https://robots.example", additional_headers=BEARER) as robot:
        assert ask(robot, seen(GOAL))["goal_reached"]


@pytest.mark.fault("I20")
def test_a_web_page_of_any_other_origin_may_not(strict: Any) -> None:
    elsewhere = robot_of(strict, origin="https://elsewhere.example", additional_headers=BEARER)
    with pytest.raises(InvalidStatus) as error, elsewhere:
        pass
    assert error.value.response.status_code == 403


@pytest.mark.fault("I20")
def test_a_message_over_the_limit_ends_the_connection(robot: ClientConnection) -> None:
    with pytest.raises(ConnectionClosed) as error:  # noqa: PT012  # which of the two meets the end is open
        robot.send(bytes(MAX_BYTES + 1))
        robot.recv(60)
    assert error.value.rcvd is not None
    assert error.value.rcvd.code == 1009


@pytest.mark.fault("I20")
def test_a_message_in_crumbs_ends_the_connection(faulty: Any) -> None:
    with raw_connection(faulty) as crumbs:
        crumbs.sendall(frame(2, b"", is_last=False) + frame(0, b"", is_last=False) * MAX_FRAGMENTS)
        received = b""
        while part := crumbs.recv(4096):
            received += part
    assert struct.pack("!H", 1009) in received


@pytest.mark.fault("I20")
def test_a_handshake_that_is_none_ends_the_connection(faulty: Any) -> None:
    upgrade = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    for rest in ("\r\n", f"X-Long: {'x' * 9000}\r\n\r\n"):
        assert b" 101 " not in faulty.raw((upgrade + rest).encode())


@pytest.mark.fault("I20")
def test_connections_are_counted(faulty: Any) -> None:
    with ExitStack() as open_ones:
        for _ in range(STREAMS):
            open_ones.enter_context(robot_of(faulty))
        with pytest.raises(InvalidStatus) as error, robot_of(faulty):
            pass
        assert error.value.response.status_code == 429
        assert error.value.response.headers["retry-after"] == "1"
    with robot_of(faulty) as robot:
        assert ask(robot, seen(GOAL))["goal_reached"]


@pytest.mark.fault("I21")
def test_a_robot_that_says_nothing_for_long_loses_its_connection(strict: Any) -> None:
    with robot_of(strict, additional_headers=BEARER) as robot, pytest.raises(ConnectionClosed) as error:
        robot.recv(10 * IDLE_S)
    assert error.value.rcvd is not None
    assert error.value.rcvd.reason == "deadline_exceeded: Connect again. A message must come within 5 s; none came."


@pytest.mark.fault("I21")
def test_a_robot_that_does_not_read_loses_its_connection_and_fills_no_memory(
    strict: Any, wait_until: Callable[..., float]
) -> None:
    before = strict.process.memory_info().rss
    with raw_connection(strict, TOKEN) as deaf:
        deaf.settimeout(60)
        with pytest.raises(OSError, match=r"reset|[Bb]roken|timed"):
            deaf.sendall((frame(9, bytes(125)) + frame(2, b"\xc1")) * 500_000)
        wait_until(lambda: strict.metric('freerein_calls_in_flight{protocol="websocket"}') == 0, 60)
    assert strict.process.memory_info().rss - before < 64 * 2**20


@pytest.mark.fault("I22")
def test_a_service_that_stops_answers_what_it_has_and_says_so(
    start_policy: Callable[..., Any], wait_until: Any
) -> None:
    faulty = start_policy()
    with robot_of(faulty) as busy, robot_of(faulty) as idle:
        busy.send(pack(seen(1, hundredths=50)))
        wait_until(lambda: faulty.metric('freerein_calls_in_flight{protocol="websocket"}') == 2, 60)
        assert faulty.service.stop() == 0
        assert isinstance(busy.recv(60), bytes)
        for robot in (busy, idle):
            with pytest.raises(ConnectionClosed) as error:
                robot.recv(60)
            assert error.value.rcvd is not None
            assert error.value.rcvd.code == 1012


@pytest.mark.fault("I21")
def test_a_robot_that_vanished_loses_its_connection(abandoned: tuple[Any, float], wait_until: Any) -> None:
    faulty, since = abandoned
    wait_until(lambda: not faulty.metric('freerein_calls_in_flight{protocol="websocket"}'), 12 * PING_S)
    assert time.monotonic() - since > PING_S
