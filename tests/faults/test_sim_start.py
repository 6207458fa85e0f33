"""Workers of the sim service that are killed while it starts."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from tests.child_processes import children_running

pytestmark = [pytest.mark.e2e, pytest.mark.fault("F8")]


DIES = """
import os, pathlib

pathlib.Path(os.environ["STARTS"], str(os.getpid())).touch()
os.kill(os.getpid(), 9)
"""
"""A world that kills the worker which imports it."""


@pytest.fixture
def kill_new_workers(wait_until: Any) -> Callable[..., set[int]]:
    """A function that kills each worker as soon as it is there, and returns their ids when `until` holds of them."""

    def kill(service: Any, *, until: Callable[[set[int]], bool]) -> set[int]:
        killed: set[int] = set()

        def is_enough() -> bool:
            with suppress(psutil.NoSuchProcess):
                for child in children_running("freerein_sim.workers", service.process.pid):
                    child.kill()
                    killed.add(child.pid)
            return until(killed)

        wait_until(is_enough, 300)
        return killed

    return kill


def test_a_worker_killed_while_the_service_starts_is_started_again(
    start_service: Callable[..., Any], kill_new_workers: Callable[..., set[int]], wait_until: Any
) -> None:
    service = start_service("freerein_sim", FREEREIN_SIM_WORKERS="2")
    kill_new_workers(service, until=lambda killed: len(killed) >= 2)

    wait_until(service.is_ready, 300)
    assert service.stop() == 0


def test_a_service_whose_workers_keep_dying_ends_as_one_to_be_restarted(
    start_service: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "dies.py").write_text(DIES)
    (tmp_path / "dies-1.dist-info").mkdir()
    (tmp_path / "dies-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: dies\nVersion: 1\n")
    (tmp_path / "dies-1.dist-info" / "entry_points.txt").write_text("[freerein.worlds]\ndies = dies:TASKS\n")
    starts = tmp_path / "starts"
    starts.mkdir()
    service = start_service("freerein_sim", FREEREIN_SIM_WORKERS="1", PYTHONPATH=str(tmp_path), STARTS=str(starts))

    assert service.process.wait(300) == 1
    assert len(list(starts.iterdir())) == 4
    lines = [line for line in service.log.read_text().splitlines() if not line.startswith("{")]
    (reason,) = lines
    assert reason.startswith("cannot start: A worker process died 4 times while starting.")
