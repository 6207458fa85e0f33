"""Services as child processes: restarted, given up, drained, never left behind. The services here are tiny."""

import asyncio
import os
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest

from freerein.cli.commands.up import page_line
from freerein.errors import DeadlineExceeded, FailedPrecondition
from freerein.ports import Ports
from freerein.stack import RestartPolicy, ServiceStatus, Stack
from freerein.stack.endpoints import free_ports, hold

_READY = """
import os, signal, socket, subprocess, sys
def drain(*_):
    print("drained", flush=True)
    sys.exit(0)
signal.signal(signal.SIGTERM, drain)
worker = subprocess.Popen(["sleep", "600"])
print("worker", worker.pid, flush=True)
with socket.create_server(("127.0.0.1", int(os.environ["FREEREIN_HTTP_PORT"]))) as server:
    while True:
        with server.accept()[0] as connection:
            connection.recv(65536)
            connection.sendall(b"HTTP/1.1 200 OK\\r\\ncontent-length: 0\\r\\nconnection: close\\r\\n\\r\\n")
"""
_MISCONFIGURED = 'import sys; sys.exit(sys.stderr.write("cannot start: FREEREIN_QUEUE: too small\\n") and 3)'
_TOLD = 'import os, sys; print(*map(os.environ.get, ("FREEREIN_SIM_ADDRESS", "FREEREIN_SIM_URL"))); sys.exit(3)'
_CRASHING = "raise SystemExit(1)"
_MUTE = "import time; time.sleep(600)"
_HASTY = RestartPolicy(first_delay_s=0.01, longest_delay_s=0.02, crashes=3, window_s=600)
_PARENT = """
import asyncio, os, sys
from pathlib import Path
from freerein.stack import Stack, free_ports
async def main():
    ports = free_ports(["sim"])
    async with Stack({"sim": "tiny"}, data_dir=Path(sys.argv[1]), environ=os.environ, ports=ports) as stack:
        await stack.ready(timeout_s=300)
        print(stack.statuses[0].pid, flush=True)
        await asyncio.Event().wait()
asyncio.run(main())
"""


@pytest.fixture
def environ(tmp_path: Path) -> dict[str, str]:
    """An environment in which `tiny` can be imported once a test has written it."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])}


@pytest.fixture
def tiny(tmp_path: Path, environ: dict[str, str], reserve_ports: Any) -> Callable[..., Stack]:
    """A function that makes a stack of one service from its source."""

    def make(source: str, policy: RestartPolicy = _HASTY) -> Stack:
        (tmp_path / "tiny.py").write_text(source)
        ports = reserve_ports(["sim"])
        return Stack({"sim": "tiny"}, data_dir=tmp_path, environ=environ, ports=ports, policy=policy)

    return make


@asynccontextmanager
async def _ready(stack: Stack) -> AsyncIterator[Stack]:
    async with stack:
        await stack.ready(timeout_s=300)
        yield stack


async def _until(stack: Stack, holds: Callable[[ServiceStatus], bool]) -> ServiceStatus:
    async with asyncio.timeout(300):
        async for statuses in stack.watch():
            if holds(statuses[0]):
                return statuses[0]
    raise AssertionError


def _log(tmp_path: Path) -> list[str]:
    return (tmp_path / "logs" / "sim.log").read_text().splitlines()


async def test_a_killed_service_is_started_again_at_the_same_address(tiny: Callable[[str], Stack]) -> None:
    async with _ready(tiny(_READY)) as stack:
        before = stack.statuses[0]
        os.kill(before.pid, signal.SIGKILL)
        after = await _until(stack, lambda status: status.restarts == 1 and status.state == "ready")

    assert after.pid != before.pid
    assert after.rest_url == before.rest_url


async def test_what_a_killed_service_started_is_gone_before_the_next_one_starts(
    tiny: Callable[[str], Stack], tmp_path: Path
) -> None:
    async with _ready(tiny(_READY)) as stack:
        worker = psutil.Process(int(_log(tmp_path)[0].split()[1]))
        os.kill(stack.statuses[0].pid, signal.SIGKILL)
        await _until(stack, lambda status: status.restarts == 1)

    _, alive = psutil.wait_procs([worker], timeout=60)
    assert alive == []


async def test_a_configuration_error_is_shown_and_never_tried_again(tiny: Callable[[str], Stack]) -> None:
    async with tiny(_MISCONFIGURED) as stack:
        with pytest.raises(FailedPrecondition, match="FREEREIN_QUEUE: too small"):
            await stack.ready(timeout_s=300)

        assert stack.statuses[0].state == "misconfigured"
        assert stack.statuses[0].restarts == 0


@pytest.mark.parametrize("replicas", ["", "here:9104,there:9104"])
async def test_an_address_that_the_environment_sets_is_what_services_are_told_and_else_address_and_url(
    tiny: Callable[[str], Stack], environ: dict[str, str], tmp_path: Path, replicas: str
) -> None:
    environ["FREEREIN_SIM_ADDRESS"] = replicas
    async with tiny(_TOLD) as stack:
        await _until(stack, lambda status: status.has_failed)

    own = f"{stack.addresses['sim']} {stack.urls['sim']}"
    assert _log(tmp_path) == [f"{replicas} None" if replicas else own]


async def test_a_service_that_was_ready_is_tried_again_however_often_it_crashes(tiny: Callable[..., Stack]) -> None:
    async with tiny(_READY, replace(_HASTY, crashes=2)) as stack:
        for restarts in range(2):
            ready = await _until(stack, lambda each, count=restarts: (each.state, each.restarts) == ("ready", count))
            os.kill(ready.pid, signal.SIGKILL)
        after = await _until(stack, lambda each: each.state in ("restarting", "given up") and each.restarts == 1)
        assert after.state == "restarting"


async def test_a_service_that_keeps_crashing_as_it_starts_is_given_up(tiny: Callable[..., Stack]) -> None:
    async with tiny(_CRASHING, _HASTY) as stack:
        status = await _until(stack, lambda status: status.has_failed)

    assert status.state == "given up"
    assert status.restarts == _HASTY.crashes - 1


async def test_leaving_the_block_drains_the_services(tiny: Callable[[str], Stack], tmp_path: Path) -> None:
    async with _ready(tiny(_READY)) as stack:
        process = psutil.Process(stack.statuses[0].pid)

    assert not process.is_running()
    assert _log(tmp_path)[-1] == "drained"
    assert stack.statuses[0].state == "stopped"


async def test_a_service_that_opens_no_door_is_not_ready_in_time(tiny: Callable[[str], Stack]) -> None:
    async with tiny(_MUTE) as stack:
        await _until(stack, lambda status: status.reason == "It does not listen yet.")
        with pytest.raises(DeadlineExceeded, match="sim: It does not listen yet"):
            await stack.ready(timeout_s=0.5)


def test_services_do_not_outlive_a_killed_supervisor(tmp_path: Path, environ: dict[str, str]) -> None:
    (tmp_path / "tiny.py").write_text(_READY)
    command = [sys.executable, "-c", _PARENT, str(tmp_path)]
    with subprocess.Popen(command, env=environ, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        service = psutil.Process(int(parent.stdout.readline()))
        parent.kill()

    _, alive = psutil.wait_procs([service], timeout=60)
    psutil.Process(int(_log(tmp_path)[0].split()[1])).kill()  # the tiny service does not stop its own worker
    assert alive == []


async def test_a_port_that_somebody_holds_is_named_before_anything_starts(tmp_path: Path) -> None:
    held = await asyncio.start_server(lambda *_: None, "127.0.0.1", 0)
    port = held.sockets[0].getsockname()[1]
    ports = {"sim": Ports(port, free_ports(["sim"])["sim"].grpc)}

    async with held:
        with pytest.raises(FailedPrecondition, match=f"Port {port} must be free for sim"):
            async with Stack({"sim": "tiny"}, data_dir=tmp_path, environ={}, ports=ports):
                pass


async def test_the_ports_of_services_that_do_not_listen_yet_are_given_to_nobody(
    tmp_path: Path, environ: dict[str, str]
) -> None:
    (tmp_path / "tiny.py").write_text(_MUTE)
    ports = free_ports(["sim"])

    async with Stack({"sim": "tiny"}, data_dir=tmp_path, environ=environ, ports=ports):
        for port in (ports["sim"].rest, ports["sim"].grpc):
            with socket.socket() as other, pytest.raises(OSError, match="in use"):
                other.bind(("127.0.0.1", port))
    hold(ports).close()


def test_free_ports_are_free_and_different() -> None:
    ports = free_ports(["sim", "segmentation"])

    hold(ports).close()
    assert len({port for pair in ports.values() for port in (pair.rest, pair.grpc)}) == 4


@pytest.mark.parametrize(
    ("states", "says"),
    [
        ({"orchestrator": "ready", "sim": "starting"}, ""),
        ({"orchestrator": "starting", "sim": "ready"}, ""),
        ({"sim": "ready"}, ""),
        ({"orchestrator": "given up", "sim": "ready"}, ""),
        ({"orchestrator": "ready", "sim": "ready"}, "See and steer everything in a browser: http://orchestrator/"),
        ({"orchestrator": "ready", "sim": "given up"}, "See and steer everything in a browser: http://orchestrator/"),
    ],
)
def test_where_the_page_is_is_said_last_when_all_have_started(states: dict[str, Any], says: str) -> None:
    assert page_line(tuple(ServiceStatus(name, each, f"http://{name}", "") for name, each in states.items())) == says
