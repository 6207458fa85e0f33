"""Bad bodies, headers and names over real sockets: refused for what they are, at once, and never repeated."""

import http.client
import json
import re
import socket
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h11
import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.faults.growth import Growth

from freerein.serving.rest.http_server import BoundedConnection
from freerein.serving.rest.middleware import MAX_HEADER_BYTES

pytestmark = pytest.mark.e2e
MiB = 2**20
JSON = {"content-type": "application/json"}
SEGMENT = "/v1/segment"


@pytest.fixture(scope="module")
def audit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("audit") / "touched.txt"


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any], audit: Path) -> Any:
    return start_faulty(FAULTY_AUDIT=str(audit), FREEREIN_RECEIPT_S="60")  # for large bodies on a busy machine


def raw_request(method: str, path: str, body: bytes = b"", *headers: str) -> bytes:
    return "\r\n".join([f"{method} {path} HTTP/1.1", "host: localhost", *headers, "", ""]).encode("latin-1") + body


def status(reply: bytes) -> int:
    return int(reply.split(b" ", 2)[1]) if reply else 0


# --- what they say


DEEP = b"[" * 100_000 + b"1" + b"]" * 100_000
BAD = {  # of the many that `freerein/test_body.py` has
    "no finite number": ("application/json", b'{"smoothing": NaN}', 422),
    "no UTF-8": ("application/json", b'{"dataset": "\xff"}', 422),
    "a key twice": ("application/json", b'{"smoothing": 1.0, "smoothing": 1.0}', 422),
    "deep": ("application/json", b'{"images": %s}' % DEEP, 422),
    "a million mistakes": ("application/json", b'{"images": [%s{}]}' % (b'{"encoding": "secret"},' * 200_000), 422),
    "many keys": ("application/json", b"{%s}" % b",".join(b'"%d": "secret"' % each for each in range(100_000)), 422),
    "a long text": ("application/json", b'{"model": {"name": "%s"}}' % (b"secret" * 500_000), 422),
    "a long key": ("application/json", b'{"%s": 1}' % (b"secret" * 500_000), 422),
    "another type": ("image/png", b"\x89PNG\r\n\x1a\n\0\xff", 415),
    "another charset": ("application/json; charset=latin1", b'{"model": {"name": "\xe4"}}', 415),
    "a type of no text": ("\xff\xfe", b"{}", 415),
    "no boundary": ("multipart/form-data", b"{}", 400),
    "no parts": ("multipart/form-data; boundary=b", b"secret", 400),
}


@pytest.mark.fault("C1")
@pytest.mark.fault("C2")
@pytest.mark.fault("C3")
@pytest.mark.fault("C4")
@pytest.mark.fault("C6")
def test_a_bad_body_has_a_small_answer_at_once_that_repeats_nothing(faulty: Any, refusal: Any) -> None:
    for name, (content_type, body, expected) in BAD.items():
        before = faulty.cpu_s()
        reply = faulty.http.post(SEGMENT, content=body, headers={"content-type": content_type.encode("latin-1")})
        refusal(reply, expected)
        assert b"secret" not in reply.content, name
        assert faulty.cpu_s() - before < 1, name


# --- sizes


def gigabyte(prefix: bytes) -> Iterator[bytes]:
    yield prefix
    for _ in range(1024):
        yield b" " * MiB


def send_until_refused(faulty: Any, parts: Iterator[bytes], *headers: str) -> tuple[int, int]:
    """Sends chunks until the service answers or closes; returns the status and how many MiB went."""
    sent = 0
    with faulty.connect() as connection:
        connection.sendall(raw_request("POST", SEGMENT, b"", "transfer-encoding: chunked", *headers))
        connection.setblocking(False)
        reply, waiting = b"", b""
        while not reply:
            if not waiting:
                part = next(parts)
                waiting, sent = b"%x\r\n%s\r\n" % (len(part), part), sent + len(part)
            try:
                waiting = waiting[connection.send(waiting) :]
            except BlockingIOError:
                time.sleep(0.001)
            except (BrokenPipeError, ConnectionResetError):
                connection.setblocking(True)
                return status(connection.recv(65536)), sent // MiB
            try:
                reply = connection.recv(65536)
            except BlockingIOError:
                continue
        return status(reply), sent // MiB


@pytest.mark.fault("C5")
@pytest.mark.parametrize("content_type", ["application/json", "multipart/form-data; boundary=b"])
def test_a_body_without_an_end_is_refused_at_the_limit(faulty: Any, content_type: str) -> None:
    prefix = (
        b'--b\r\ncontent-disposition: form-data; name="images"; filename="a"\r\n\r\n'
        if "multi" in content_type
        else b" "
    )
    with Growth(faulty.process) as growth:
        code, sent = send_until_refused(faulty, gigabyte(prefix), f"content-type: {content_type}")
    assert code == 413
    assert sent < 80
    assert growth.most < 64 * MiB + 16 * MiB


@pytest.mark.fault("C5")
def test_a_body_that_says_it_is_too_large_is_refused_unread(faulty: Any, refusal: Any) -> None:
    with Growth(faulty.process) as growth:
        reply = faulty.raw(
            raw_request("POST", SEGMENT, b"", "content-type: application/json", f"content-length: {2**30}")
        )
        assert status(reply) == 413
        refusal(faulty.http.post(SEGMENT, content=b" " * (64 * MiB + 1), headers=JSON), 413)
    assert growth.most < 16 * MiB


@pytest.mark.fault("C5")
def test_a_body_of_just_the_limit_is_read(faulty: Any) -> None:
    frames = json.dumps(faulty.trajectory()).encode()
    reply = faulty.http.post(SEGMENT, content=frames + b" " * (64 * MiB - len(frames)), headers=JSON)
    assert reply.json()["labels"] == [0, 1]


@pytest.mark.fault("C5")
@pytest.mark.parametrize(
    "headers",
    [
        ("content-length: -1",),
        ("content-length: ten",),
        ("content-length: 2", "content-length: 3"),
        ("content-length: 0x10",),
        ("content-length: 1e3",),
        ("content-length: +2",),
        ("content-length: 2", "transfer-encoding: chunked, gzip"),
    ],
)
def test_a_malformed_length_is_malformed(faulty: Any, headers: tuple[str, ...]) -> None:
    reply = faulty.raw(raw_request("POST", SEGMENT, b"{}", "content-type: application/json", *headers))
    assert status(reply) in (400, 501)
    assert b"application/problem+json" in reply


@pytest.mark.fault("C5")
def test_a_body_of_small_values_takes_no_more_memory_than_its_bytes(faulty: Any, refusal: Any) -> None:
    body = b'{"images": [%s[]]}' % (b"[]," * (20 * MiB))
    with Growth(faulty.process) as growth:
        refusal(faulty.http.post(SEGMENT, content=body, headers=JSON), 422)
    assert growth.most < 3.5 * len(body)  # in parts, whole, and what the allocator holds back


@pytest.mark.fault("C5")
@pytest.mark.parametrize("content", [b"{}", iter([b"{}"])], ids=["of a length", "in chunks"])
def test_a_request_by_get_has_no_body(faulty: Any, refusal: Any, content: Any) -> None:
    refusal(faulty.http.request("GET", "/v1/list-skills", content=content), 400)


@pytest.mark.fault("C5")
def test_a_compressed_body_is_not_opened(faulty: Any, refusal: Any) -> None:
    with Growth(faulty.process) as growth:
        headers = {**JSON, "content-encoding": "gzip"}
        refusal(faulty.http.post(SEGMENT, content=b"\x1f\x8b" + b"\0" * MiB, headers=headers), 415)
    assert growth.most < 16 * MiB


def in_chunks(data: bytes, size: int) -> bytes:
    """Returns a body in HTTP chunks."""
    parts = (data[i : i + size] for i in range(0, len(data), size))
    return b"".join(b"%x\r\n%s\r\n" % (len(part), part) for part in parts) + b"0\r\n\r\n"


def send_chunks(faulty: Any, total: int, size: int) -> bytes:
    """Returns the reply to a valid body of so many bytes, in chunks of a size."""
    body = json.dumps(faulty.trajectory()).encode().ljust(total)
    headers = ("content-type: application/json", "transfer-encoding: chunked", "connection: close")
    reply: bytes = faulty.raw(raw_request("POST", SEGMENT, in_chunks(body, size), *headers))
    return reply


@pytest.mark.fault("F5")
@pytest.mark.parametrize(("total", "size", "expected"), [(16_384, 1, 200), (65_536, 64, 200), (65_536, 63, 400)])
def test_large_bodies_must_come_in_chunks_of_64_bytes_or_more(
    faulty: Any, total: int, size: int, expected: int
) -> None:
    reply = send_chunks(faulty, total, size)
    assert status(reply) == expected
    assert expected == 200 or b"application/problem+json" in reply


@pytest.mark.fault("F5")
def test_chunks_of_64_bytes_may_be_cut_anywhere_and_the_last_may_be_small() -> None:
    connection = BoundedConnection(h11.SERVER, MAX_HEADER_BYTES)
    sent = raw_request("POST", SEGMENT, in_chunks(b"x" * 17_000, 64), "transfer-encoding: chunked")
    for i in range(len(sent)):
        connection.receive_data(sent[i : i + 1])
        while connection.next_event() not in (h11.NEED_DATA, h11.PAUSED):
            pass
    assert connection.their_state is h11.DONE


@pytest.mark.fault("F5")
def test_a_body_of_tiny_chunks_takes_little_time(faulty: Any) -> None:
    before = faulty.cpu_s()
    assert status(send_chunks(faulty, 500_000, 1)) in (0, 400)  # 0: closed before all was sent
    assert faulty.cpu_s() - before < 1.0  # 3 s when all were parsed
    assert faulty.segment(2, 3).json()["labels"] == [0, 1]


@pytest.mark.fault("F5")
def test_a_body_may_come_in_tiny_segments(faulty: Any) -> None:
    body = json.dumps(faulty.trajectory()).encode().ljust(20_000)
    headers = ("content-type: application/json", f"content-length: {len(body)}", "connection: close")
    with faulty.connect() as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(raw_request("POST", SEGMENT, b"", *headers))
        for i in range(0, len(body), 10):
            connection.sendall(body[i : i + 10])
        assert status(connection.recv(65536)) == 200


@pytest.mark.fault("F6")
def test_many_large_bodies_at_once_stay_within_the_memory_for_all(faulty: Any) -> None:
    frames = {"datatype": "UINT8", "shape": [45 * MiB // 48, 4, 4, 3], "raw": "A" * (60 * MiB)}
    body = json.dumps({"frames": frames}).encode()

    def post(_: int) -> int:
        return int(faulty.http.post(SEGMENT, content=body, headers=JSON).status_code)

    with Growth(faulty.process) as growth, ThreadPoolExecutor(5) as pool:
        statuses = set(pool.map(post, range(5)))
    assert statuses == {413, 429}  # read, and of too many timesteps; or refused for now
    assert growth.most < 600 * MiB


@pytest.mark.fault("C10")
@pytest.mark.parametrize(
    "data",
    [
        raw_request("POST", SEGMENT, b"0\r\n\r\n", "content-length: 2", "transfer-encoding: chunked"),
        raw_request("POST", SEGMENT, b"zz\r\nxx\r\n", "transfer-encoding: chunked"),
        raw_request("POST", SEGMENT, b"2\r\n{}\r\nzz\r\n", "transfer-encoding: chunked"),
        raw_request("GET", "/healthz", b"", "host: y"),
        raw_request("GET", "/healthz", b"", "x-a : 1"),
        raw_request("GET", "/\xff", b""),
        b"GET /healthz HTTP/1.1\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\r\n\r\n",
    ],
    ids=["two lengths", "no size", "no second size", "two hosts", "space", "not ASCII", "no host", "TLS"],
)
def test_what_could_be_read_as_two_requests_is_none_and_ends_the_connection(faulty: Any, data: bytes) -> None:
    reply = faulty.raw(data + raw_request("GET", "/metrics"))
    assert status(reply) == 400
    assert len(re.findall(rb"HTTP/1.1 \d", reply)) == 1


@pytest.mark.fault("C9")
@pytest.mark.parametrize(
    ("path", "headers"),
    [
        ("/v1/list-skills", ("x-large: " + "x" * 70_000,)),
        ("/v1/list-skills", tuple(f"x-{i}: 1" for i in range(1_000))),
        ("/v1/list-skills", ("a: b",) * 150),
        ("/" + "x" * 65_536, ()),
        ("/v1/list-skills?model.name=" + "x" * 65_536, ()),
    ],
)
def test_headers_and_urls_have_a_limit(faulty: Any, path: str, headers: tuple[str, ...]) -> None:
    assert status(faulty.raw(raw_request("GET", path, b"", "connection: close", *headers))) in (400, 414, 431, 0)
    assert status(faulty.raw(raw_request("GET", "/healthz", b"", "connection: close"))) == 200


# --- names and paths

HOSTILE_NAMES = st.one_of(
    st.sampled_from(
        [
            "../../etc/passwd",
            "..",
            ".",
            "/etc/passwd",
            "a/../b",
            "%2e%2e%2f",
            "..\\..",
            "a\0b",
            "\uff41",
            "\u0430",
            "x" * 4096,
        ]
    ),
    st.text(min_size=1, max_size=80).filter(lambda text: not text.isalnum()),
).filter(lambda name: not set(name) <= set("abcdefghijklmnopqrstuvwxyz0123456789._-") or name[0] in "._-")


@pytest.mark.fault("C15")
@pytest.mark.fault("G11")
@given(name=HOSTILE_NAMES)
def test_a_name_that_is_no_name_is_refused_and_opens_nothing(faulty: Any, refusal: Any, audit: Path, name: str) -> None:
    before = len(audit.read_bytes())
    replies = [
        faulty.http.post(SEGMENT, json={**faulty.trajectory(), "model": {"name": name}}),
        faulty.http.post(SEGMENT, json={**faulty.trajectory(), "model": {"version": name}}),
        faulty.http.post("/v1/start-fit", json={"dataset": name}),
        faulty.http.post("/v1/start-fit", json={"dataset": "x", "model_name": name}),
        faulty.http.post("/v1/start-fit", json={"dataset": "x", "idempotency_key": name}),
        faulty.http.post("/v1/cancel-fit", json={"id": name}),
        faulty.http.get("/v1/get-fit", params={"id": name}),
        faulty.http.get("/v1/watch-fit", params={"id": name}),
        faulty.http.post("/v1/activate-model", json={"name": name, "version": "0" * 12}),
        faulty.http.post("/v1/activate-model", json={"name": "", "version": name}),
    ]
    for reply in replies:
        refusal(reply, 422)
    touched = audit.read_bytes()[before:].decode(errors="replace").splitlines()
    assert all(str(faulty.service.data_dir) in line for line in touched), touched


@pytest.mark.fault("C15")
@pytest.mark.parametrize(
    "path", ["/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/v1/../v1/segment", "//v1/segment", "/v1/segment/"]
)
def test_a_path_that_is_no_route_is_not_found(faulty: Any, path: str) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", faulty.service.http_port, timeout=60)
    connection.putrequest("GET", path)
    connection.endheaders()
    reply = connection.getresponse()
    body = reply.read()
    connection.close()
    assert (reply.status, reply.headers["content-type"]) == (404, "application/problem+json")
    assert b"root:" not in body


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "TRACE", "OPTIONS", "FOO", "GET"])
def test_another_method_is_refused_and_the_right_one_named(faulty: Any, refusal: Any, method: str) -> None:
    reply = faulty.http.request(method, SEGMENT)
    refusal(reply, 405)
    assert reply.headers["allow"] == "POST"


def test_the_reply_carries_the_request_id_it_was_given_unless_that_is_none(faulty: Any) -> None:
    assert faulty.http.get("/healthz", headers={"x-request-id": "mine-1"}).headers["x-request-id"] == "mine-1"
    given = httpx.Headers([("x-request-id", 'a"b <script>')])
    assert faulty.http.get("/healthz", headers=given).headers["x-request-id"].isalnum()


def test_a_reply_names_no_server(faulty: Any) -> None:
    assert "server" not in faulty.http.get("/healthz").headers
