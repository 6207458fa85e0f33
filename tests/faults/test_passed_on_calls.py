"""Calls that the orchestrator passes on to other services: as the service itself answers, and none held up by another.

The services are a real one, one that accepts and never answers, one that is away, and one that a test plays itself.
"""

import asyncio
import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
from tests.conftest import reserve_port
from tests.faults.demonstrations import record_demonstrations

from freerein_orchestrator.web.calls import CALLS
from freerein_orchestrator.web.passing_on import CALLS_AT_ONCE

pytestmark = [pytest.mark.e2e, pytest.mark.fault("C28")]
TOKEN = "correct-horse-battery"
HEADERS = {"authorization": f"Bearer {TOKEN}"}
SEGMENTATION = "/services/segmentation"
HEAD = b"HTTP/1.1 200 OK\r\ncontent-type: application/json\r\ncontent-length: %d\r\n\r\n"
HALF = bytes(100_000)


@dataclass(frozen=True)
class Line:
    """A connection to the orchestrator, and the one that it has made for it to the service that a test plays."""

    ours: socket.socket
    theirs: socket.socket


@dataclass(frozen=True)
class Page:
    """The orchestrator that passes calls on, as a page sees it.

    Attributes:
        http: HTTP client of it.
        url: Its URL.
        faulty: The segmentation service behind it.
        played: Listens where the sim service should.
        away: Where the reward service should be.
    """

    http: httpx.Client
    url: str
    faulty: Any
    played: socket.socket
    away: str

    def begin(self, request: bytes) -> Line:
        """Sends the beginning of a request for the service that a test plays, and accepts what comes of it."""
        port = int(self.url.rpartition(":")[2])
        ours = socket.create_connection(("127.0.0.1", port), 60)
        ours.sendall(request)
        theirs, _ = self.played.accept()
        theirs.settimeout(60)
        return Line(ours, theirs)


@pytest.fixture(scope="module")
def page(start_faulty: Any, start_module_service: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    data_dir = tmp_path_factory.mktemp("data")
    record_demonstrations(data_dir)
    faulty = start_faulty(data_dir, FREEREIN_TOKEN=TOKEN)
    with (
        socket.create_server(("127.0.0.1", 0)) as played,
        socket.create_server(("127.0.0.1", 0), backlog=256) as mute,
    ):
        played.settimeout(60)
        urls = {
            "SEGMENTATION": faulty.service.url,
            "SIM": f"http://127.0.0.1:{played.getsockname()[1]}",
            "IMITATION": f"http://127.0.0.1:{mute.getsockname()[1]}",
            "REWARD": f"http://127.0.0.1:{reserve_port()}",
        }
        environ = {f"FREEREIN_{name}_URL": url for name, url in urls.items()}
        service = start_module_service("freerein_orchestrator", data_dir, FREEREIN_TOKEN=TOKEN, **environ)
        with httpx.Client(base_url=service.url, headers=HEADERS, timeout=120, trust_env=False, verify=False) as http:
            yield Page(http, service.url, faulty, played, urls["REWARD"])


@pytest.mark.parametrize(
    ("method", "path", "options"),
    [
        ("GET", "/v1/list-skills", {}),
        ("GET", "/v1/list-models", {}),
        ("GET", "/v1/list-models?page_size=x&page_size=y", {}),
        ("GET", "/v1/get-fit?id=" + "1" * 32, {}),
        ("GET", "/v1/watch-fit?id=..%2Fx", {}),
        ("POST", "/v1/segment", {"json": {"frames": {"datatype": "FP32", "shape": [1], "raw": "AAAAAA=="}}}),
        ("POST", "/v1/segment?tensors=rows", {"json": {}}),
        ("POST", "/v1/segment", {"content": b"{", "headers": {"content-type": "application/json"}}),
        ("POST", "/v1/segment", {"content": b"{}", "headers": {"content-type": "text/plain"}}),
        ("POST", "/v1/segment", {"files": {"images": ("0.png", b"GIF89a")}}),
        ("GET", "/readyz", {}),
        ("GET", "/openapi.json", {}),
    ],
)
def test_a_call_is_answered_as_by_the_service_itself(page: Page, method: str, path: str, options: Any) -> None:
    replies = []
    for url in (page.faulty.service.url, page.url + SEGMENTATION):
        headers = {**options.get("headers", {}), "x-request-id": "same", "host": "localhost"}
        fixed = {key: value for key, value in options.items() if key != "headers"}
        reply = page.http.request(method, url + path, headers=headers, **fixed)
        told = {key: value for key, value in reply.headers.items() if key not in ("date", "x-powered-by")}
        replies.append((reply.status_code, reply.content, told))
    if path == "/openapi.json":  # which names where it was asked for
        assert [json.loads(content)["info"] for _, content, _ in replies] == [json.loads(replies[0][1])["info"]] * 2
    else:
        assert replies[0] == replies[1]


def test_a_trajectory_is_labelled_and_a_listed_call_of_each_kind_gets_through(page: Page) -> None:
    reply = page.http.post(f"{SEGMENTATION}/v1/segment", json=page.faulty.trajectory([0, 1, 1]))
    assert reply.json()["labels"] == [0, 1, 1]
    assert "freerein_calls_total" in page.http.get(f"{SEGMENTATION}/metrics").text


@pytest.mark.parametrize(
    "path",
    [
        f"{SEGMENTATION}/v1/delete-model",
        f"{SEGMENTATION}/v1/segment/",
        f"{SEGMENTATION}/v1/segment%2f..%2fdelete-model",
        f"{SEGMENTATION}/healthz",
        f"{SEGMENTATION}/docs",
        f"{SEGMENTATION}/",
        "/services/sim/v1/snapshot",
        "/services/sim/v1/demonstrate",
        "/services/imitation/v1/publish-policy",
        "/services/orchestrator/v1/list-runs",
        "/services/elsewhere/readyz",
        "/services",
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_nothing_else_gets_through(page: Page, refusal: Any, method: str, path: str) -> None:
    refusal(page.http.request(method, path), 404)


def test_a_call_has_the_method_that_it_has_at_the_service(page: Page, refusal: Any) -> None:
    assert refusal(page.http.get(f"{SEGMENTATION}/v1/segment"), 405)["code"] == "method_not_allowed"


def test_every_call_needs_the_token(page: Page, refusal: Any) -> None:
    paths = [f"/services/{name}/readyz" for name in CALLS] + [f"{SEGMENTATION}/v1/list-skills", "/services/sim/v1/step"]
    for path in paths:
        refusal(httpx.get(page.url + path, trust_env=False), 401)


@pytest.mark.fault("C27")
def test_the_cookie_of_a_session_opens_every_door_to_the_own_page_alone(page: Page, refusal: Any) -> None:
    with httpx.Client(base_url=page.url, timeout=120, trust_env=False, verify=False) as browser:
        assert browser.post("/session", json={"token": TOKEN}).status_code == 204
        doors = [("POST", f"{SEGMENTATION}/v1/segment"), ("GET", f"{SEGMENTATION}/v1/list-skills")]
        doors += [("POST", "/v1/cancel-run"), ("GET", "/v1/list-datasets"), ("GET", "/v1/watch-run?id=" + "1" * 32)]
        for method, path in doors:
            for origin in ("http://elsewhere.example", "http://127.0.0.1:1", "null"):
                problem = refusal(browser.request(method, path, headers={"origin": origin}), 403)
                assert problem["code"] == "permission_denied"
            own = browser.request(method, path, headers={"origin": page.url, "sec-fetch-site": "same-origin"})
            assert own.status_code not in (401, 403), path
            no_origin = browser.request(method, path)
            assert (no_origin.status_code == 403) == (method == "POST"), path


def test_a_service_that_is_away_is_named_with_what_to_do(page: Page, refusal: Any) -> None:
    begun = time.monotonic()
    problem = refusal(page.http.post("/services/reward/v1/reward", json={}), 503)
    assert time.monotonic() - begun < 2
    assert problem["code"] == "unavailable"
    assert f"The reward service must run at {page.away}" in problem["detail"]
    assert "freerein up reward" in problem["hint"]
    assert "FREEREIN_REWARD_URL" in problem["hint"]


async def test_a_service_that_hangs_holds_up_no_other(page: Page, refusal: Any) -> None:
    limits = httpx.Limits(max_connections=None)
    async with httpx.AsyncClient(
        base_url=page.url, headers=HEADERS, limits=limits, timeout=120, trust_env=False, verify=False
    ) as http:
        held = [asyncio.create_task(http.get("/services/imitation/readyz")) for _ in range(CALLS_AT_ONCE + 1)]
        done, pending = await asyncio.wait(held, return_when=asyncio.FIRST_COMPLETED)
        problem = refusal(done.pop().result(), 429)
        assert (len(pending), problem["code"]) == (CALLS_AT_ONCE, "overloaded")
        assert "imitation" in problem["detail"]
        assert (await http.get(f"{SEGMENTATION}/v1/list-skills")).status_code == 200
        assert (await http.get("/healthz")).status_code == 200
        for each in pending:
            each.cancel()
        await asyncio.gather(*pending, return_exceptions=True)
        while await _is_refused(http):  # until the orchestrator has noticed that those callers have left
            pass


def test_bodies_are_passed_on_as_they_come_in_both_directions(page: Page) -> None:
    head = f"POST /services/sim/v1/step?tensors=list HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {TOKEN}\r\n"
    head += f"content-type: application/json\r\ncontent-length: {2 * len(HALF)}\r\nx-secret: 1\r\n\r\n"
    line = page.begin(head.encode() + HALF)
    with line.ours, line.theirs:
        asked, _, body = _until(line.theirs, lambda got: len(got) >= len(HALF)).partition(b"\r\n\r\n")
        assert asked.startswith(b"POST /v1/step?tensors=list HTTP/1.1\r\n")
        assert b"x-secret" not in asked
        assert body.strip(b"\0") == b""
        line.ours.sendall(HALF)  # not before the first half has arrived
        _until(line.theirs, lambda got: len(got) >= 2 * len(HALF) - len(body))
        line.theirs.sendall(HEAD % (2 * len(HALF)) + HALF)
        got = _until(line.ours, lambda got: len(got.partition(b"\r\n\r\n")[2]) >= len(HALF))
        assert got.startswith(b"HTTP/1.1 200 ")
        line.theirs.sendall(HALF)
        _until(line.ours, lambda more: len(got) + len(more) >= 2 * len(HALF))


def test_a_body_over_the_limit_is_refused_and_the_service_hears_of_none(page: Page, refusal: Any) -> None:
    too_large = 'freerein_calls_total{code="too_large",method="Segment",protocol="rest"}'
    for url, count in ((page.url + SEGMENTATION, 0), (page.faulty.service.url, 1)):
        refusal(page.http.post(f"{url}/v1/segment", content=bytes(64 * 2**20 + 1)), 413)
        assert page.faulty.metric(too_large) == count


@pytest.mark.parametrize("has_begun", [False, True], ids=["before its reply", "in the middle of its reply"])
def test_a_caller_that_leaves_ends_its_call(page: Page, has_begun: bool) -> None:
    request = f"POST /services/sim/v1/reset HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {TOKEN}\r\n"
    line = page.begin(request.encode() + b"content-length: 2\r\n\r\n{}")
    with line.theirs:
        _until(line.theirs, lambda got: got.endswith(b"{}"))
        if has_begun:
            line.theirs.sendall(HEAD % 2 + b"{")
            _until(line.ours, lambda got: got.endswith(b"{"))
        line.ours.close()
        assert line.theirs.recv(1) == b""


def test_a_reply_that_breaks_off_is_no_whole_reply(page: Page) -> None:
    request = f"GET /services/sim/v1/list-tasks HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {TOKEN}\r\n\r\n"
    line = page.begin(request.encode())
    with line.ours:
        _until(line.theirs, lambda got: got.endswith(b"\r\n\r\n"))
        line.theirs.sendall(HEAD % 10 + b"{")
        line.theirs.close()
        got = b""
        while part := line.ours.recv(65536):
            got += part
        assert got.endswith(b"\r\n\r\n{")


def test_a_service_with_another_token_is_no_reason_to_sign_in_again(page: Page) -> None:
    request = f"GET /services/sim/v1/list-tasks HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {TOKEN}\r\n\r\n"
    line = page.begin(request.encode())
    with line.ours, line.theirs:
        asked = _until(line.theirs, lambda got: got.endswith(b"\r\n\r\n"))
        assert f"authorization: Bearer {TOKEN}".encode() in asked.lower().replace(b"bearer", b"Bearer")
        line.theirs.sendall(b"HTTP/1.1 401 \r\ncontent-length: 0\r\n\r\n")
        got = _until(line.ours, lambda got: got.endswith(b"}"))
        assert got.startswith(b"HTTP/1.1 503 ")
        assert b"same FREEREIN_TOKEN" in got


@pytest.mark.fault("O11")
def test_events_are_passed_on_and_taken_up_after_the_last_one(page: Page) -> None:
    config = {"steps": 1_000_000, "features": 8, "hidden_size": 8}
    started = page.http.post(f"{SEGMENTATION}/v1/start-fit", json={"dataset": "demos", "config": config})
    fit_id = started.json()["fit"]["id"]
    watch = f"{SEGMENTATION}/v1/watch-fit?id={fit_id}"
    with ExitStack() as watching:
        stream = watching.enter_context(page.http.stream("GET", watch))
        assert stream.headers["content-type"].startswith("text/event-stream")
        lines = stream.iter_lines()
        first = next(line for line in lines if line.startswith("data:"))  # while the fit goes on
        assert json.loads(first.removeprefix("data:"))["sequence"] == 0
        page.http.post(f"{SEGMENTATION}/v1/cancel-fit", json={"id": fit_id})
        rest = [json.loads(line.removeprefix("data:")) for line in lines if line.startswith("data:")]
        assert rest[-1]["fit"]["state"] == "cancelled"
    again = page.http.get(watch, headers={"last-event-id": "0"}).text
    assert [json.loads(line[5:]) for line in again.splitlines() if line.startswith("data:")] == rest


async def _is_refused(http: httpx.AsyncClient) -> bool:
    """Returns whether there is no room for a call to the service that hangs; where there is, it is not answered."""
    with suppress(TimeoutError):
        async with asyncio.timeout(0.5):
            return (await http.get("/services/imitation/readyz")).status_code == 429
    return False


def _until(connection: socket.socket, holds: Callable[[bytes], bool]) -> bytes:
    """Returns what arrives until a condition of it holds."""
    got = b""
    while not holds(got):
        part = connection.recv(65536)
        assert part, got[-200:]
        got += part
    return got
