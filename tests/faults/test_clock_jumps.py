"""The wall clock jumps while services run: leases, deadlines and queues are unaffected. Skipped without libfaketime."""

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from tests.child_processes import children_running

from freerein.clients import Channel, SimClient, SyncClient
from freerein.errors import Overloaded
from freerein.types.sim import CloseSessionRequest, CreateSessionRequest, ResetRequest, StepRequest

LIBRARY = next(iter(sorted(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"))), None)
pytestmark = [
    pytest.mark.e2e,
    pytest.mark.fault("C23"),
    pytest.mark.skipif(LIBRARY is None, reason="needs libfaketime: apt-get install faketime"),
]
JUMPS = [3600, -3600]


class WallClock:
    """The wall clock of the services that are started with `environ`; their monotonic clock is the machine's."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self.environ = {
            "LD_PRELOAD": str(LIBRARY),
            "FAKETIME_TIMESTAMP_FILE": str(file),
            "FAKETIME_NO_CACHE": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        }
        self.jump(0)

    def jump(self, seconds: int) -> None:
        """Sets the clock to that many seconds from now."""
        self._file.write_text(f"{seconds:+d}")


@pytest.fixture(scope="module")
def wall_clock(tmp_path_factory: pytest.TempPathFactory) -> WallClock:
    return WallClock(tmp_path_factory.mktemp("clock") / "now")


@pytest.fixture(autouse=True)
def _right_clock(wall_clock: WallClock) -> Iterator[None]:
    yield
    wall_clock.jump(0)


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any], wall_clock: WallClock) -> Any:
    limits = {"FREEREIN_SIM_WORKERS": "1", "FREEREIN_SIM_SESSIONS": "2"}
    service = start_module_service("freerein_sim", **wall_clock.environ, **limits)
    return service.until_ready()


def logged_ahead_s(service: Any) -> float:
    """Returns how far ahead the clock of a service's last log line is."""
    last = json.loads(service.log.read_text().splitlines()[-1])
    return (datetime.fromisoformat(last["timestamp"]) - datetime.now(UTC)).total_seconds()


@pytest.mark.parametrize("seconds", JUMPS)
def test_a_lease_ends_after_its_own_time_whatever_the_clock_says(
    sim: Any, wall_clock: WallClock, seconds: int, wait_until: Any
) -> None:
    with SyncClient(SimClient(Channel(sim.address))) as client:
        kept = client.create_session(CreateSessionRequest("grid", seed=1)).session
        client.reset(ResetRequest(kept))
        client.create_session(CreateSessionRequest("grid", seed=1, lease_s=3.0))
        with pytest.raises(Overloaded):
            client.create_session(CreateSessionRequest("grid"))

        wall_clock.jump(seconds)

        others: list[str] = []
        wait_until(lambda: has_room(client, others), 60)
        assert client.step(StepRequest(kept, 1, np.array([[3]]))).step_id == 1
        assert abs(logged_ahead_s(sim) - seconds) < 60
        for session in (kept, *others):
            client.close_session(CloseSessionRequest(session))


def has_room(client: Any, sessions: list[str]) -> bool:
    """Adds a session where there is room for one; returns whether there was."""
    with suppress(Overloaded):
        sessions.append(client.create_session(CreateSessionRequest("grid")).session)
    return bool(sessions)


@pytest.mark.parametrize("seconds", JUMPS)
def test_calls_that_run_or_wait_are_answered_whatever_the_clock_says(
    sim: Any, wall_clock: WallClock, seconds: int, wait_until: Any
) -> None:
    (worker,) = children_running("freerein_sim.workers", sim.process.pid)
    with SyncClient(SimClient(Channel(sim.address))) as client, ThreadPoolExecutor(3) as threads:
        session = client.create_session(CreateSessionRequest("grid", seed=1)).session
        worker.suspend()
        over_rest = threads.submit(
            httpx.post, f"{sim.url}/v1/reset", json={"session": session}, timeout=60, trust_env=False
        )
        over_grpc = [threads.submit(client.reset, ResetRequest(session), timeout_s=60) for _ in range(2)]
        wait_until(lambda: sim.in_flight("rest") == sim.in_flight("grpc") == 2, 60)
        assert not over_rest.done()
        wall_clock.jump(seconds)
        sim.is_ready()
        worker.resume()
        assert over_rest.result().status_code == 200
        assert [call.result().frames for call in over_grpc] == [{}, {}]
        client.close_session(CloseSessionRequest(session))
    assert abs(logged_ahead_s(sim) - seconds) < 60
