"""Watchers of a run that do not read: the run never waits for them."""

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


def events(orchestrator: httpx.Client, run_id: str) -> list[Any]:
    with orchestrator.stream("GET", "/v1/watch-run", params={"id": run_id}) as reply:
        assert reply.status_code == 200
        return [json.loads(line.removeprefix("data:")) for line in reply.iter_lines() if line.startswith("data:")]


def test_watchers_that_never_read_delay_nobody(orchestrator: httpx.Client) -> None:
    config = {"task": "grid", "dataset": "crowded", "behaviour": "random", "count": COUNT}
    reply = orchestrator.post("/v1/start-run", json={"kind": "collect", "config": config})
    assert reply.status_code == 200, reply.text
    run_id = reply.json()["run"]["id"]
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
