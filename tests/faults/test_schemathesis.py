"""Requests generated from each service's own OpenAPI document, sent to it as a process."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.e2e, pytest.mark.fault("C1"), pytest.mark.fault("G8"), pytest.mark.timeout(3_600)]
CHECKS = "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance"
WATCH = "/v1/watch-"
EVENTS = ["--exclude-path-regex", f"^{WATCH}"]  # what they watch may never end
CASES = 20_000  # in `make fuzz`
SERVICES = {
    "segmentation": ("tests.faults.faulty_service", {}),
    "imitation": ("tests.faults.faulty_policy", {"FREEREIN_SHIPPED_DIR": "none"}),
    "reward": ("tests.faults.faulty_reward", {"FREEREIN_SHIPPED_DIR": "none"}),
    "sim": ("freerein_sim", {"FREEREIN_SIM_WORKERS": "1", "FREEREIN_SIM_SESSIONS": "8"}),
    "orchestrator": ("freerein_orchestrator", {}),
}


@pytest.mark.parametrize(
    ("name", "seconds"),
    [("orchestrator", 1), *(pytest.param(name, 30, marks=pytest.mark.long) for name in SERVICES)],
)
def test_no_generated_request_breaks_a_service_or_its_document(
    start_service: Callable[..., Any], tmp_path: Path, fuzz: bool, name: str, seconds: int
) -> None:
    module, environ = SERVICES[name]
    service = start_service(module, **environ)
    document = f"{service.url}/openapi.json"
    paths = json.loads(service.get("/openapi.json")[1])["paths"]
    operations = sum(not path.startswith(WATCH) for path in paths)
    budget = ["--max-examples", str(CASES // operations)] if fuzz else ["--max-time", str(seconds)]
    budget += ["--request-timeout", "60"]
    options = ["--continue-on-failure", "--generation-database", "none", "--suppress-health-check", "all", "--no-color"]
    ran = subprocess.run(
        [
            Path(sys.executable).with_name("schemathesis"),
            "run",
            document,
            "--checks",
            CHECKS,
            *EVENTS,
            *options,
            *budget,
        ],
        check=False,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert ran.returncode == 0, ran.stdout[-5_000:]
    assert f"{operations} selected / {len(paths)} total" in ran.stdout
    assert service.process.poll() is None
    assert '"event": "bug"' not in service.log.read_text()
    assert service.stop() == 0
