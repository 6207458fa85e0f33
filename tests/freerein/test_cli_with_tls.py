"""The command line and a service with TLS and a token."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import grpc
import pytest

from freerein.cli.connection import connect
from freerein.cli.doctor import services
from freerein.clients import SimClient
from freerein.types.sim import ListTasksRequest

pytestmark = pytest.mark.e2e


@pytest.fixture(scope="module")
def shared(certificate: tuple[Path, Path]) -> dict[str, str]:
    """The environment of the service and of those who call it."""
    return {"FREEREIN_HOST": "0.0.0.0", "FREEREIN_TLS_CERT": str(certificate[1]), "FREEREIN_TOKEN": "right"}


@pytest.fixture(scope="module")
def service(start_module_service: Any, certificate: tuple[Path, Path], shared: dict[str, str]) -> Any:
    """A sim service with a certificate, at all addresses and at other ports than usual."""
    key = str(certificate[0])
    return start_module_service("freerein_sim", FREEREIN_TLS_KEY=key, FREEREIN_SIM_WORKERS="1", **shared)


@pytest.fixture
def sim(service: Any, shared: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> Any:
    """The service, and an environment that says where it is."""
    ports = {"FREEREIN_HTTP_PORT": str(service.http_port), "FREEREIN_GRPC_PORT": str(service.grpc_port)}
    for variable, value in (shared | ports).items():
        monkeypatch.setenv(variable, value)
    return service


async def test_the_doctor_and_the_command_line_speak_tls(
    sim: Any, monkeypatch: pytest.MonkeyPatch, wait_until: Callable[..., float]
) -> None:
    monkeypatch.setattr(services, "_TIMEOUT_S", 60.0)
    (check,) = services.checks(["sim"])
    wait_until(lambda: check().state != "warning", 300)  # its workers start
    found = check()
    assert (found.state, found.detail) == ("ok", f"ready at {sim.url.replace('http', 'https')}, gRPC {sim.address}")
    monkeypatch.setenv("FREEREIN_SIM_ADDRESS", sim.address)
    async with connect(SimClient, "sim") as client:
        assert (await client.list_tasks(ListTasksRequest())).tasks


def test_the_doctor_says_what_a_call_lacks(sim: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def found(**environ: str) -> tuple[str, str]:
        with monkeypatch.context() as changed:
            for variable, value in environ.items():
                changed.setenv(f"FREEREIN_{variable}", value)
            (check,) = services.checks(["sim"])
            while "starting" in (result := check()).detail:
                pass
            return result.state, f"{result.detail} {result.fix}"

    for address in ("", sim.address):  # here, and away
        monkeypatch.setenv("FREEREIN_SIM_ADDRESS", address)
        assert found()[0] == "ok"
        for token, says in (("wrong", "refuses the token"), ("", "needs a token")):
            state, text = found(TOKEN=token)
            assert (state, says in text, "Set FREEREIN_TOKEN" in text) == ("problem", True, True)
        assert found(TLS_CERT="") == (
            "problem",
            "speaks TLS, and FREEREIN_TLS_CERT is not set here Set FREEREIN_TLS_CERT to the service's certificate.",
        )
        state, text = found(TLS_CERT="/none.pem")
        assert (state, "a PEM file that can be read: No such file" in text) == ("problem", True)


@pytest.mark.parametrize(
    ("answers", "state", "says"), [(True, "warning", "without a token, too"), (False, "problem", "another service")]
)
def test_the_doctor_says_of_a_service_that_it_asks_for_no_token_or_is_another(
    monkeypatch: pytest.MonkeyPatch, answers: bool, state: str, says: str
) -> None:
    class Everything(grpc.GenericRpcHandler):
        def service(self, _call: Any) -> Any:
            return grpc.unary_unary_rpc_method_handler(lambda request, _context: request)

    server = grpc.server(ThreadPoolExecutor(1), [Everything()] if answers else [])
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    monkeypatch.setenv("FREEREIN_SIM_ADDRESS", f"127.0.0.1:{port}")
    monkeypatch.setenv("FREEREIN_TOKEN", "mine")
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")  # calls to this machine take none
    (check,) = services.checks(["sim"])
    result = check()
    server.stop(None).wait()
    assert (result.state, says in result.detail) == (state, True)
