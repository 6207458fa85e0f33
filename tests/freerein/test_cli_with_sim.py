"""`freerein up` with the real sim service, and demonstrations recorded from it."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.cli.commands import sim
from freerein.cli.commands.sim import record
from freerein.cli.jobs.streams import reconnecting
from freerein.clients import Channel, SimClient
from freerein.data import Dataset
from freerein.types.sim import DemonstrateRequest

pytestmark = pytest.mark.e2e


@dataclass(frozen=True)
class Up:
    """A running `freerein up sim`: the process, and the last status that it printed."""

    process: "subprocess.Popen[str]"
    status: dict[str, object]


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    """The sim service, run by `freerein up`, ready."""
    environ = {**os.environ, "FREEREIN_DATA_DIR": str(tmp_path_factory.mktemp("up")), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "freerein.cli", "up", "sim", "--free-ports", "--json"]
    with subprocess.Popen(command, env=environ, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        status = next(status for line in process.stdout if (status := json.loads(line))["state"] == "ready")
        yield Up(process, status)
        process.kill()


@pytest.fixture
def recorder(up: Up, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The datasets' folder of a data directory, to which verbs record from the running service."""
    monkeypatch.setenv("FREEREIN_SIM_ADDRESS", str(up.status["grpc_address"]))
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    return tmp_path / "datasets"


def _demonstrate(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["sim", "demonstrate", "grid", "--json", "--max-skills", "2", *words])
    return result.exit_code, result.stdout or result.stderr


def test_the_tasks_are_listed(recorder: Path) -> None:
    document = json.loads(CliRunner().invoke(app, ["sim", "tasks", "--json"]).stdout)

    assert "grid" in [task["name"] for task in document["tasks"]]


def test_a_recording_gone_on_with_is_the_recording_made_at_once(recorder: Path) -> None:
    _demonstrate("--out", "begun", "--count", "2", "--truth")
    code, printed = _demonstrate("--out", "begun", "--count", "5", "--truth")
    _demonstrate("--out", "whole", "--count", "5", "--truth")

    assert (code, json.loads(printed)) == (0, {"dataset": "begun", "trajectories": 5})
    assert Dataset(recorder / "begun").fingerprint == Dataset(recorder / "whole").fingerprint


def test_a_recording_under_conditions_goes_on_under_the_same_in_any_order(recorder: Path) -> None:
    varied = ("--condition", "warm", "--condition", "blur")
    _demonstrate("--out", "varied", "--count", "1", *varied)
    codes = [
        _demonstrate("--out", "varied", "--count", "2", *each)[0] for each in (varied[2:] + varied[:2], varied[:2])
    ]

    assert codes == [0, 1]
    assert json.loads((recorder / "varied" / "recording.json").read_text())["conditions"] == ["blur", "warm"]


def test_a_recording_is_not_gone_on_with_by_another_request(recorder: Path) -> None:
    _demonstrate("--out", "demos", "--count", "1", "--seed", "1")

    code, printed = _demonstrate("--out", "demos", "--count", "2", "--seed", "2")

    assert (code, json.loads(printed)["error"]["code"]) == (1, "failed_precondition")
    assert _demonstrate("--out", "demos", "--count", "2", "--seed", "2", "--replace")[0] == 0
    assert len(Dataset(recorder / "demos")) == 2


@pytest.mark.parametrize("words", [["nothing"], ["grid", "--skill", "fly"], ["grid", "--condition", "night"]])
def test_what_is_refused_leaves_no_dataset(recorder: Path, words: list[str]) -> None:
    result = CliRunner().invoke(app, ["sim", "demonstrate", *words, "--out", "demos"])

    assert result.exit_code == 1
    assert not recorder.exists()


@pytest.mark.fault("C19")
async def test_a_recording_goes_on_when_its_service_is_killed(
    tmp_path: Path, start_service: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    request = DemonstrateRequest("grid", "expert", max_skills=2, count=150)  # more than can be under way at once
    monkeypatch.setattr(sim, "reconnecting", partial(reconnecting, timeout_s=300.0))
    started = [start_service("freerein_sim", FREEREIN_SIM_WORKERS="1")]

    def kill_in_the_middle(count: int) -> None:
        if count == 2 and len(started) == 1:
            started[0].kill()
            port = str(started[0].grpc_port)
            started.append(start_service("freerein_sim", FREEREIN_SIM_WORKERS="1", FREEREIN_GRPC_PORT=port))

    async with SimClient(Channel(started[0].address)) as client:
        await record(client, request, tmp_path / "killed", on_count=kill_in_the_middle)
        await record(client, replace(request, count=9), tmp_path / "whole", on_count=lambda _: None)
    killed, whole = (sorted((tmp_path / name / "data").rglob("*.parquet")) for name in ("killed", "whole"))
    assert (len(started), len(killed)) == (2, 150)
    assert [each.read_bytes() for each in killed[:9]] == [each.read_bytes() for each in whole]


def test_a_signal_drains_the_services_and_the_exit_code_is_0(up: Up) -> None:
    up.process.send_signal(signal.SIGTERM)

    assert up.process.stdout is not None
    assert json.loads(up.process.stdout.readlines()[-1])["state"] == "stopped"
    assert up.process.wait(60) == 0
