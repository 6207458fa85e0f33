"""The command line and a service with TLS."""

from pathlib import Path
from typing import Any

import pytest

from freerein.cli.connection import connect
from freerein.cli.doctor import services
from freerein.clients import SimClient
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


async def test_the_doctor_and_the_command_line_speak_tls(sim: Any) -> None:
    while (found := services.check_service("sim")).state == "warning":
        pass  # its workers start
    assert found.state == "ok", found
    async with connect(SimClient, "sim") as client:
        assert (await client.list_tasks(ListTasksRequest())).tasks
