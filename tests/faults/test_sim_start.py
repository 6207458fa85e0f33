"""Workers of the sim service that are killed while it starts."""

import time
from collections.abc import Callable
from typing import Any

import httpx
import psutil
import pytest

pytestmark = [pytest.mark.e2e, pytest.mark.fault("F8")]


def kill_new_workers(service: Any, *, until: Callable[[set[int]], bool]) -> set[int]:
    """Kills each child of the service as soon as it is there; returns the process ids when `until` holds of them."""
    killed: set[int] = set()
    begun = time.monotonic()
    while not until(killed):
        assert time.monotonic() - begun < 30
        try:
            for child in psutil.Process(service.process.pid).children():
                child.kill()
                killed.add(child.pid)
        except psutil.NoSuchProcess:
            continue
    return killed


def test_a_worker_killed_while_the_service_starts_is_started_again(start_service: Callable[..., Any]) -> None:
    service = start_service("freerein_sim", FREEREIN_SIM_WORKERS="2")
    kill_new_workers(service, until=lambda killed: len(killed) >= 2)

    while httpx.get(f"{service.url}/readyz", trust_env=False).status_code != 200:
        assert service.process.poll() is None, service.log.read_text()

    assert service.stop() == 0


def test_a_service_whose_workers_keep_dying_ends_as_one_to_be_restarted(start_service: Callable[..., Any]) -> None:
    service = start_service("freerein_sim", FREEREIN_SIM_WORKERS="1")

    killed = kill_new_workers(service, until=lambda _: service.process.poll() is not None)

    assert service.process.returncode == 1
    assert len(killed) == 4
    lines = [line for line in service.log.read_text().splitlines() if not line.startswith("{")]
    (reason,) = lines
    assert reason.startswith("cannot start: A worker process died 4 times while starting.")
