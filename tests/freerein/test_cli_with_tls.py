"""The command line and a service whose doors speak TLS."""

import os
from pathlib import Path
from typing import Any

import pytest

from freerein.cli.demo.context import Context
from freerein.cli.demo.report import Reporter
from freerein.cli.doctor import doors
from freerein.cli.services import running_endpoints
from freerein.cli.settings import CliSettings
from freerein.errors import Unavailable
from freerein.ports import PORTS, Ports
from freerein.types.sim import ListTasksRequest

pytestmark = pytest.mark.e2e


@pytest.fixture
def sim(start_service: Any, certificate: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> Any:
    """A sim service with a certificate, which the command line knows, where sim services usually are."""
    key, chain = map(str, certificate)
    service = start_service("freerein_sim", FREEREIN_TLS_CERT=chain, FREEREIN_TLS_KEY=key, FREEREIN_SIM_WORKERS="1")
    monkeypatch.setitem(PORTS, "sim", Ports(service.http_port, int(service.address.rpartition(":")[2])))
    monkeypatch.setenv("FREEREIN_TLS_CERT", chain)
    return service


async def test_the_doctor_and_the_demo_speak_tls_and_say_when_the_connection_is_lost(sim: Any, tmp_path: Path) -> None:
    context = Context(
        running_endpoints(["sim"], os.environ), CliSettings(), tmp_path, tmp_path, 0, Reporter(as_json=True)
    )

    while (found := doors.service("sim")).state == "warning":
        pass  # its workers start
    assert found.state == "ok", found
    async with context.rest("sim") as rest, context.sim() as client:
        over_rest = {task["name"] for task in (await rest.get("/v1/list-tasks"))["tasks"]}
        over_grpc = {task.name for task in (await client.list_tasks(ListTasksRequest())).tasks}
        sim.process.kill()
        with pytest.raises(Unavailable, match="must answer; the connection failed"):
            await rest.get("/v1/list-tasks")

    assert over_rest == over_grpc != set()
