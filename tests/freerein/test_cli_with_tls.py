"""The command line and a service with TLS."""

from pathlib import Path
from typing import Any

import pytest

from freerein.cli.connection import connect
from freerein.cli.doctor import services
from freerein.clients import SimClient
from freerein.types.sim import ListTasksRequest

pytestmark = pytest.mark.e2e


@pytest.fixture
def sim(start_service: Any, certificate: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> Any:
    """A sim service with a certificate, at all addresses and at other ports than usual, as the environment says."""
    key, chain = map(str, certificate)
    shared = {"FREEREIN_HOST": "0.0.0.0", "FREEREIN_TLS_CERT": chain}
    service = start_service("freerein_sim", FREEREIN_TLS_KEY=key, FREEREIN_SIM_WORKERS="1", **shared)
    ports = {"FREEREIN_HTTP_PORT": str(service.http_port), "FREEREIN_GRPC_PORT": str(service.grpc_port)}
    for variable, value in (shared | ports).items():
        monkeypatch.setenv(variable, value)
    return service


async def test_the_doctor_and_the_command_line_speak_tls(sim: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services, "_TIMEOUT_S", 60.0)
    (check,) = services.checks(["sim"])
    while (found := check()).state == "warning":
        pass  # its workers start
    assert (found.state, found.detail) == ("ok", f"ready at {sim.url.replace('http', 'https')}, gRPC {sim.address}")
    monkeypatch.setenv("FREEREIN_SIM_ADDRESS", sim.address)
    async with connect(SimClient, "sim") as client:
        assert (await client.list_tasks(ListTasksRequest())).tasks
