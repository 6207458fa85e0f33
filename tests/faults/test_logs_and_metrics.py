"""What requests leave in logs and metrics: lines of JSON without secrets, and labels from fixed sets."""

import contextlib
import json
import os
import re
from collections import Counter
from collections.abc import Callable
from socket import SHUT_RDWR
from typing import Any

import grpc
import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from freerein import wire
from freerein.types.learning import WatchFitRequest

pytestmark = pytest.mark.e2e
TOKEN = "correct-horse-battery"
FORGED = '\n{"event": "forged", "level": "critical"}\r\n\x1b[31mred'
SEGMENT = "/v1/segment"
FITS = "/freerein.api.learning.v1.FitService/"
PATHS = {"GetFit": "/v1/get-fit", "WatchFit": "/v1/watch-fit"}
STREAMS = [("rest", "WatchFit"), ("grpc", "WatchFit"), ("websocket", "/")]
METHODS = [("rest", "GetFit"), ("grpc", "GetFit"), *STREAMS]
CALLS = [
    *[(method, "answered", TOKEN, "ok") for method in METHODS],
    *[(method, "refused", TOKEN, "not_found") for method in METHODS],
    *[(method, "answered", "none", "unauthenticated") for method in METHODS],
    *[(method, "open", TOKEN, "cancelled") for method in STREAMS],
    *[(method, "broken", TOKEN, "out_of_storage") for method in STREAMS if method[1] == "WatchFit"],
]
FIELDS = {"event", "level", "timestamp", "service", "request_id", "protocol", "method", "code", "ms"}


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty(FREEREIN_TOKEN=TOKEN)


def garbage(faulty: Any, number: int) -> list[httpx.Request]:
    """Returns requests whose every part is of the client's choice, and another one for each number."""
    text = f"{FORGED}{number}"
    escaped = httpx.QueryParams({"id": text, text: TOKEN})
    make, authorized = faulty.http.build_request, {"authorization": f"Bearer {TOKEN}"}
    return [
        make("GET", f"/v1/{number}/{escaped}"),
        make("GET", "/v1/get-fit", params=escaped),
        make("POST", f"/v1/start-fit?{escaped}", json={"dataset": text, "config": {text: text}}),
        make("POST", SEGMENT, json={"model": {"name": text}, text: text}),
        make("POST", SEGMENT, files={text: (text, text)}),
        make("POST", SEGMENT, content=text, headers={"content-type": f"application/x-{number}"}),
        make(f"METHOD{number}", SEGMENT),
        make("GET", "/v1/list-models", headers={"authorization": f"Bearer {TOKEN}{number}"}),
        make("GET", "/v1/list-models", headers={"x-request-id": "x" * 5_000, **authorized}),
        make("GET", "/v1/list-models", headers={"x-request-id": b"\x1b[31m\xff" + str(number).encode()}),
    ]


@pytest.mark.fault("C24")
def test_a_client_cannot_write_lines_into_the_log_nor_find_the_token_there(faulty: Any) -> None:
    for request in garbage(faulty, 0):
        assert faulty.http.send(request).status_code < 500
    faulty.segment(1, fault="raises")  # whose traceback is in the log
    faulty.raw(FORGED.encode() + b"\r\n\r\n")
    text = faulty.service.log.read_text()
    lines = [json.loads(line) for line in text.splitlines()]
    assert {"listening", "call", "the model failed"} <= {line["event"] for line in lines}
    assert "forged" not in text
    assert "\x1b" not in text
    assert TOKEN not in text
    assert all(len(str(value)) <= 2_000 for line in lines for key, value in line.items() if key != "exception")


@pytest.mark.fault("F11")
def test_what_clients_send_wrong_is_no_warning(faulty: Any) -> None:
    before = len(faulty.service.log.read_text())
    for request in garbage(faulty, 1):
        faulty.http.send(request)
    faulty.raw(b"no HTTP\r\n\r\n")
    faulty.http.post(SEGMENT, content=b"x", headers={"content-type": "multipart/form-data; boundary=b"})
    levels = {json.loads(line)["level"] for line in faulty.service.log.read_text()[before:].splitlines()}
    assert levels == {"info"}


@pytest.mark.fault("F11")
@pytest.mark.parametrize(
    "crash",
    ["raise ValueError('x')", "import threading as t; f = t.Thread(target=lambda: 1 / 0); f.start(); f.join()"],
)
def test_a_crash_is_a_line_of_json_too(crash: str, run_child: Callable[..., tuple[int, str]]) -> None:
    _, log = run_child("tests.code", f"from freerein.serving import logs; logs.configure('x'); {crash}")
    (line,) = map(json.loads, log.splitlines())
    assert line["event"] == "crashed"
    assert "Error" in line["exception"]


def test_long_fields_of_a_line_are_cut(run_child: Callable[..., tuple[int, str]]) -> None:
    program = "import logging; from freerein.serving import logs; logs.configure('x'); "
    code, log = run_child("tests.code", program + "logging.warning('y' * 9999, extra={'field': 'z' * 9999})")
    assert code == 0
    line = json.loads(log)
    assert (line["event"], line["field"]) == ("y" * 2_000, "z" * 2_000)


@pytest.mark.fault("C25")
def test_the_number_of_metric_series_does_not_grow_with_what_clients_send(faulty: Any, fuzz: bool) -> None:
    def series() -> set[str]:
        return set(re.findall(r"^(freerein_\S+) ", faulty.http.get("/metrics").text, re.MULTILINE))

    def send(numbers: range) -> None:
        for number in numbers:
            for request in garbage(faulty, number):
                faulty.http.send(request)

    send(range(3))
    series()  # which itself is a call, and counted
    before = series()
    send(range(3, 1_000 if fuzz else 20))
    assert series() == before
    assert len(before) <= 500


def test_metrics_of_a_disk_that_hangs_end_at_the_deadline_of_a_call(
    start_faulty: Callable[..., Any], refusal: Callable[..., Any]
) -> None:
    faulty = start_faulty(FREEREIN_UNARY_S="1")
    faulty.service.until_ready()
    fit = faulty.service.data_dir / "fits" / "segmentation" / ("0" * 32)
    fit.mkdir(parents=True)
    os.mkfifo(fit / "events.jsonl")  # to open it takes as long as nobody writes
    for _ in range(2):
        assert refusal(faulty.http.get("/metrics"), 504)["code"] == "deadline_exceeded"
    assert faulty.segment(1).json()["labels"] == [1]


# --- calls of every kind; one that asks to stay open is left without a word


def over_rest(faulty: Any, method: str, asked: str, token: str, while_open: Callable[[], object]) -> None:
    headers = {"authorization": f"Bearer {token}"}
    with (
        contextlib.suppress(httpx.RemoteProtocolError),
        faulty.http.stream("GET", PATHS[method], params={"id": asked}, headers=headers) as reply,
    ):
        while_open() if asked == "open" else reply.read()


def over_grpc(faulty: Any, method: str, asked: str, token: str, while_open: Callable[[], object]) -> None:
    message = wire.pack(WatchFitRequest(asked)).SerializeToString()
    options: Any = {"metadata": [("authorization", f"Bearer {token}")], "timeout": 60}
    with grpc.insecure_channel(faulty.service.address) as channel, contextlib.suppress(grpc.RpcError):
        if method == "GetFit":
            channel.unary_unary(FITS + method)(message, **options)
        else:
            replies = channel.unary_stream(FITS + method)(message, **options)
            next(replies)
            while_open() if asked == "open" else list(replies)


def over_websocket(faulty: Any, _method: str, asked: str, token: str, while_open: Callable[[], object]) -> None:
    url, headers = f"ws://127.0.0.1:{faulty.service.http_port}/?id={asked}", {"authorization": f"Bearer {token}"}
    with contextlib.suppress(InvalidStatus, ConnectionClosed), connect(url, additional_headers=headers) as socket:
        socket.recv(60)
        if asked == "open":
            while_open()
            socket.socket.shutdown(SHUT_RDWR)


OVER = {"rest": over_rest, "grpc": over_grpc, "websocket": over_websocket}


def series(faulty: Any, metric: str) -> dict[str, float]:
    """Returns the values of a metric by its labels, without those of requests that are no calls."""
    found = re.findall(rf"^{metric}{{(.*)}} (\S+)$", faulty.http.get("/metrics").text, re.MULTILINE)
    return {labels: float(value) for labels, value in found if 'method="other"' not in labels}


@pytest.mark.parametrize("level", ["debug", "info"])
def test_a_call_leaves_the_same_fields_and_metrics_over_every_protocol(
    start_faulty: Callable[..., Any], wait_until: Callable[..., float], level: str
) -> None:
    faulty = start_faulty(module="tests.faults.call_kinds", FREEREIN_TOKEN=TOKEN, FREEREIN_LOG_LEVEL=level)

    def wait_for_streams(*expected: float) -> None:
        """Waits until so many streams of each method are open."""
        names = [f'method="{method}",protocol="{protocol}"' for protocol, method in STREAMS]
        wait_until(lambda: series(faulty, "freerein_open_streams") == dict(zip(names, expected, strict=True)), 60)

    for (protocol, method), asked, token, _ in CALLS:
        is_this = [stream == (protocol, method) for stream in STREAMS]
        OVER[protocol](faulty, method, asked, token, lambda each=is_this: wait_for_streams(*each))
        wait_for_streams(0, 0, 0)
    expected = Counter(
        f'code="{code}",method="{method}",protocol="{protocol}"' for (protocol, method), _, _, code in CALLS
    )
    wait_until(lambda: series(faulty, "freerein_calls_total") == expected, 60)
    unary = {f'method="GetFit",protocol="{protocol}"': 3 for protocol in ("rest", "grpc")}
    assert series(faulty, "freerein_call_seconds_count") == unary
    lines = [json.loads(line) for line in faulty.service.log.read_text().splitlines()]
    calls = [line for line in lines if line["event"] == "call"]
    assert all(set(line) == FIELDS for line in calls)
    assert len([line for line in lines if line["level"] == "error"]) == 1  # uvicorn's, of the reply that breaks off
    assert Counter((line["protocol"], line["method"], line["code"], line["level"]) for line in calls) == Counter(
        (protocol, method, code, "debug" if (method, code) == ("GetFit", "ok") else "info")
        for (protocol, method), _, _, code in CALLS
        if level == "debug" or (method, code) != ("GetFit", "ok")
    )
