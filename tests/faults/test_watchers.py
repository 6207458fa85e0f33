"""Watchers of a run come, go, and do not read: the run never waits for them, and a resumed watch misses nothing."""

import json
import socket
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

pytestmark = [pytest.mark.e2e, pytest.mark.fault("O11")]
SLOW = 60  # of 64 streams that may be open
COUNT = 6


@pytest.fixture(scope="module")
def orchestrator(start_module_service: Callable[..., Any]) -> Iterator[httpx.Client]:
    sim = start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1")
    service = start_module_service("freerein_orchestrator", FREEREIN_SIM_ADDRESS=sim.address).until_ready()
    with httpx.Client(base_url=service.url, timeout=60, trust_env=False, verify=False) as client:
        yield client
    assert '"event": "bug"' not in service.log.read_text()


def start(orchestrator: httpx.Client, key: str) -> str:
    config = {"task": "grid", "dataset": key, "behaviour": "random", "count": COUNT}
    body = {"kind": "collect", "config": config, "idempotency_key": key}
    reply = orchestrator.post("/v1/start-run", json=body)
    assert reply.status_code == 200, reply.text
    run_id: str = reply.json()["run"]["id"]
    return run_id


def events(orchestrator: httpx.Client, run_id: str, *, after: int = -1, most: int = 10**6) -> list[Any]:
    """Returns the events after one, at most so many."""
    found: list[Any] = []
    headers = {"last-event-id": str(after)} if after >= 0 else {}
    with orchestrator.stream("GET", "/v1/watch-run", params={"id": run_id}, headers=headers) as reply:
        assert reply.status_code == 200
        for line in reply.iter_lines():
            if line.startswith("data:"):
                found.append(json.loads(line.removeprefix("data:")))
            if len(found) == most:
                break
    return found


def test_watchers_that_never_read_delay_nobody(orchestrator: httpx.Client) -> None:
    run_id = start(orchestrator, "crowded")
    request = f"GET /v1/watch-run?id={run_id} HTTP/1.1\r\nhost: localhost\r\n\r\n".encode()
    slow = []
    for _ in range(SLOW):
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        connection.connect(("127.0.0.1", orchestrator.base_url.port))
        connection.sendall(request)
        slow.append(connection)
    seen = events(orchestrator, run_id)
    for connection in slow:
        connection.close()
    assert seen[-1]["run"]["state"] == "succeeded"
    assert [event["sequence"] for event in seen] == list(range(len(seen)))
    assert seen[-1]["run"]["step"] == COUNT


def test_watching_resumes_after_the_last_event_id(orchestrator: httpx.Client) -> None:
    run_id = start(orchestrator, "interrupted")
    seen = events(orchestrator, run_id, most=2)
    while seen[-1]["run"]["state"] != "succeeded":
        seen += events(orchestrator, run_id, after=seen[-1]["sequence"], most=2)
    assert seen == events(orchestrator, run_id)
