"""The ports on which `freerein up` lets services listen, as the environment says."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.errors import InvalidInput
from freerein.ports import PORTS, Ports, address, moved
from freerein.serving.settings import ServiceSettings
from freerein.stack import configured_ports
from freerein.stack.endpoints import running_endpoints


def test_without_port_variables_services_listen_on_the_port_table() -> None:
    assert configured_ports(["sim", "reward"], {"FREEREIN_HTTP_PORT": ""}) == {
        "sim": PORTS["sim"],
        "reward": PORTS["reward"],
    }


@pytest.mark.parametrize(
    ("environ", "expected"),
    [
        ({"FREEREIN_HTTP_PORT": "18104"}, Ports(18104, PORTS["sim"].grpc)),
        ({"FREEREIN_GRPC_PORT": "19104"}, Ports(PORTS["sim"].rest, 19104)),
        ({"FREEREIN_HTTP_PORT": "18104", "FREEREIN_GRPC_PORT": "19104"}, Ports(18104, 19104)),
    ],
)
def test_one_service_obeys_the_port_variables(environ: dict[str, str], expected: Ports) -> None:
    assert configured_ports(["sim"], environ) == {"sim": expected}


def test_a_port_base_moves_all_ports_and_addresses_together() -> None:
    environ = {"FREEREIN_PORT_BASE": " 18100 "}
    assert configured_ports(["orchestrator", "sim"], environ) == {
        "orchestrator": Ports(18100, 19100),
        "sim": Ports(18104, 19104),
    }
    assert (address("sim", environ), running_endpoints(["sim"], environ).urls["sim"]) == (
        "127.0.0.1:19104",
        "http://127.0.0.1:18104",
    )
    settings = ServiceSettings(port_base=18100, grpc_port=9)
    assert moved("sim", settings.port_base) == Ports(18104, 19104)
    assert configured_ports(["sim"], {**environ, "FREEREIN_GRPC_PORT": "9"}) == {"sim": Ports(18104, 9)}


@pytest.mark.parametrize(
    ("words", "detail"),
    [
        (["--port-base", "64532"], "1 to 64531"),
        (["--port-base", "0"], "1 to 64531"),
        (["--port-base", "-1"], "1 to 64531"),
        (["--port-base", "18100", "--free-ports"], "--free-ports and --port-base"),
    ],
)
def test_up_refuses_a_port_base_that_cannot_be(words: list[str], detail: str) -> None:
    result = CliRunner().invoke(app, ["up", "sim", "--json", *words])
    assert (result.exit_code, json.loads(result.stderr)["error"]["code"]) == (3, "invalid_input")
    assert detail in result.stderr


@pytest.mark.parametrize(
    ("variable", "value", "says"),
    [
        ("FREEREIN_TOKN", "abc", "did you mean `FREEREIN_TOKEN`?"),
        ("FREEREIN_TLS_CERT", "/none.pem", "a PEM file that can be read: No such file"),
        ("FREEREIN_SIM_WORKERS", "0", "misconfigured FREEREIN_SIM_WORKERS: Input should be greater"),
    ],
)
def test_up_prints_what_is_wrong_and_ends_with_3(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, reserve_ports: Any, variable: str, value: str, says: str
) -> None:
    monkeypatch.setitem(PORTS, "sim", reserve_ports(["sim"])["sim"])
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    monkeypatch.setenv(variable, value)
    result = CliRunner().invoke(app, ["up", "sim"])
    assert result.exit_code == 3
    assert says in " ".join(result.output.split())
    assert "restarting" not in result.output


def test_port_0_is_a_free_port() -> None:
    ports = configured_ports(["sim"], {"FREEREIN_HTTP_PORT": "0", "FREEREIN_GRPC_PORT": "0"})["sim"]
    assert 0 not in (ports.rest, ports.grpc)
    assert ports.rest != ports.grpc


@pytest.mark.parametrize("value", ["http", "-1", "65536", "80.5"])
def test_a_port_that_is_none_is_refused_by_its_variable(value: str) -> None:
    with pytest.raises(InvalidInput, match="0 to 65535") as error:
        configured_ports(["sim"], {"FREEREIN_GRPC_PORT": value})
    assert error.value.field == "FREEREIN_GRPC_PORT"
    assert error.value.hint


@pytest.mark.parametrize("variable", ["FREEREIN_HTTP_PORT", "FREEREIN_GRPC_PORT"])
def test_up_refuses_one_port_for_several_services(monkeypatch: pytest.MonkeyPatch, variable: str) -> None:
    monkeypatch.setenv(variable, "18104")
    result = CliRunner().invoke(app, ["up", "sim", "reward", "--json"])
    error = json.loads(result.stderr)["error"]
    assert (result.exit_code, error["code"], error["field"]) == (3, "invalid_input", variable)
    assert "one service" in error["detail"]
    assert "got 2" in error["detail"]
    assert "--free-ports" in error["hint"]


def test_up_obeys_the_port_variables_of_one_service(tmp_path: Path, reserve_ports: Any) -> None:
    ports = reserve_ports(["sim"])["sim"]
    environ = {"FREEREIN_HTTP_PORT": str(ports.rest), "FREEREIN_GRPC_PORT": str(ports.grpc)}
    command = [sys.executable, "-m", "freerein.cli", "up", "sim", "--json"]
    with subprocess.Popen(
        command, env={**os.environ, "FREEREIN_DATA_DIR": str(tmp_path), **environ}, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        status = json.loads(process.stdout.readline())
        process.terminate()
    assert status["rest_url"] == f"http://127.0.0.1:{ports.rest}"
    assert status["grpc_address"] == f"127.0.0.1:{ports.grpc}"
