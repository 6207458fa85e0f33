"""What requests leave in logs and metrics: lines of JSON without secrets, and labels from fixed sets."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

pytestmark = pytest.mark.e2e
TOKEN = "correct-horse-battery"
FORGED = '\n{"event": "forged", "level": "critical"}\r\n\x1b[31mred'
SEGMENT = "/v1/segment"


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
    assert {"listening", "request", "the model failed"} <= {line["event"] for line in lines}
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
    "crash", ["raise ValueError('x')", "import threading; threading.Thread(target=lambda: 1 / 0).start()"]
)
def test_a_crash_is_a_line_of_json_too(crash: str, tmp_path: Path) -> None:
    program = f"from freerein.serving import logs; logs.configure('x'); {crash}"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, cwd=tmp_path)
    (line,) = map(json.loads, ended.stderr.splitlines())
    assert line["event"] == "crashed"
    assert "Error" in line["exception"]


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
