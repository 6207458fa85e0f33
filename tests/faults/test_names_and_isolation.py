"""A name that comes to mean another address, and a machine without any network."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.e2e
ISOLATED = ["unshare", "--map-root-user", "--mount", "--net"]
HERE = Path(__file__).parent


@pytest.fixture(scope="module", autouse=True)
def _namespaces() -> None:
    """Skips where a user cannot have namespaces."""
    if subprocess.run([*ISOLATED, "ip", "link"], check=False, capture_output=True).returncode:
        pytest.skip("needs user namespaces and `ip`")


@pytest.mark.fault("N2")
def test_a_service_at_another_address_of_its_name_is_found_again(
    start_service: Callable[..., Any], tmp_path: Path
) -> None:
    hosts = tmp_path / "hosts"
    hosts.write_text("127.0.0.1 sim.test\n")
    first = start_service("freerein_sim", FREEREIN_SIM_WORKERS="1")
    port = first.address.rpartition(":")[2]
    command = [*ISOLATED[:3], sys.executable, HERE / "named_client.py", hosts, f"sim.test:{port}"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1) as client:
        assert client.stdin is not None
        assert client.stdout is not None
        client.stdin.write("\n")
        assert client.stdout.readline() == "answered\n"
        first.stop()
        hosts.write_text("127.0.0.2 sim.test\n")
        elsewhere = {"FREEREIN_HOST": "127.0.0.2", "FREEREIN_GRPC_PORT": port, "FREEREIN_INSECURE": "1"}
        start_service("freerein_sim", FREEREIN_SIM_WORKERS="1", **elsewhere)
        begun = time.monotonic()
        client.stdin.write("\n")
        assert client.stdout.readline() == "answered\n"
        assert time.monotonic() - begun < 60
        client.stdin.close()
        assert client.wait(60) == 0


@pytest.mark.fault("R6")
def test_a_shipped_model_answers_without_a_network(fork_program: Callable[..., Any], tmp_path: Path) -> None:
    program = fork_program("tests.faults.offline_reward", tmp_path)
    assert program.stdout.readline() in ("reward 0.0\n", "reward 1.0\n")
    assert program.process.wait(60) == 0  # once its service has ended
