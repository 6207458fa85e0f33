"""A run whose service is not there says so, and goes on when it is."""

from pathlib import Path
from typing import Any

import pytest

from freerein.clients import Channel, OrchestratorClient, SyncClient
from freerein.types.orchestrator import StartRunRequest, WatchRunRequest

pytestmark = pytest.mark.e2e


def test_a_run_tells_that_it_waits_for_a_service_until_that_is_there(
    tmp_path: Path, start_service: Any, reserve_ports: Any
) -> None:
    port = reserve_ports(["sim"])["sim"].grpc
    orchestrator = start_service("freerein_orchestrator", tmp_path, FREEREIN_SIM_ADDRESS=f"127.0.0.1:{port}")
    config = {"task": "grid", "dataset": "new", "behaviour": "random", "count": 3}
    with SyncClient(OrchestratorClient(Channel(orchestrator.address))) as runs:
        started = runs.start_run(StartRunRequest("collect", config)).run
        told = ""
        for event in runs.watch_run(WatchRunRequest(started.id)):
            if not told and event.run.error:
                told, state = event.run.error, event.run.state
                start_service("freerein_sim", tmp_path / "sim", FREEREIN_GRPC_PORT=str(port), FREEREIN_SIM_WORKERS="1")
        assert told.startswith("Waiting for a service.")
        assert state == "running"
        assert (event.run.state, event.run.error) == ("succeeded", "")
