"""From demonstrations to skill labels by verbs alone, with the real services."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from freerein.cli.__main__ import app

pytestmark = [pytest.mark.e2e, pytest.mark.slow]


@pytest.fixture
def services(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Every installed service, run by `freerein up` on free ports, which verbs are told of."""
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    command = [sys.executable, "-m", "freerein.cli", "up", "sim", "segmentation", "--free-ports", "--json"]
    with subprocess.Popen(command, env=os.environ, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        waiting = {"sim", "segmentation"}
        while waiting:
            status = json.loads(process.stdout.readline())
            if status["state"] == "ready":
                waiting -= {status["service"]}
                monkeypatch.setenv(f"FREEREIN_{status['service'].upper()}_ADDRESS", status["grpc_address"])
        yield
        process.terminate()


def _run(*words: str) -> Result:
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 0, result.output
    return result


@pytest.mark.usefixtures("services")
def test_demonstrations_become_labels() -> None:
    _run("sim", "demonstrate", "grid", "--out", "demos", "--count", "12", "--max-skills", "3")
    fit = json.loads(_run("fit", "segmentation", "demos", "--set", "steps=2", "--watch").stdout.splitlines()[-1])
    rows = [json.loads(line) for line in _run("fit", "metrics", fit["id"]).stdout.splitlines()]
    (model,) = [json.loads(line) for line in _run("models", "list").stdout.splitlines()]
    answer = json.loads(_run("segment", "demos", "--index", "3", "--min-segment", "2").stdout)

    assert fit["state"] == "succeeded"
    assert {"step": fit["step"], **fit["metrics"]} == rows[-1]
    assert (model["ref"], model["active"]) == (fit["model"], True)
    assert answer["model"] == fit["model"]
    assert answer["segments"][-1]["end"] == len(answer["labels"])
