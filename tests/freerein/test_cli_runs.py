"""`freerein run` and `jobs` as a user types them, with a real orchestrator, which collects from a real sim service."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from subprocess import PIPE
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from freerein.cli.__main__ import app
from freerein.ports import Ports

pytestmark = [pytest.mark.e2e, pytest.mark.long]

FEW = ("run", "collect", "--set", "task=grid", "--set", "dataset=few", "--set", "count=3", "--key", "few")
LARGE = ("run", "collect", "--set", "task=blocks", "--set", "count=20", "--watch")  # few are under way at once
MANY = ("run", "collect", "--set", "task=grid", "--set", "count=150", "--watch")
_SMALL = {"iterations": 1, "num_envs": 2, "num_steps": 8, "epochs": 1, "batch_size": 8, "episode_steps": 4}
_PPO = {"task": "blocks.yellow-left-of-green", "reward": "oracle", "encoder": "spatial", **_SMALL}
PPO = ("run", "ppo", *(word for key, value in _PPO.items() for word in ("--set", f"{key}={value}")), "--key", "ppo")


class Orchestrator:
    """The orchestrator's process, which tests may kill and start again at the same place."""

    def __init__(self, start_service: Callable[..., Any], data_dir: Path, sim: Any, ports: Ports) -> None:
        doors = {"FREEREIN_HTTP_PORT": str(ports.rest), "FREEREIN_GRPC_PORT": str(ports.grpc)}
        self._start = lambda: start_service(
            "freerein_orchestrator", data_dir, FREEREIN_SIM_ADDRESS=sim.address, **doors
        )
        self.sim, self.service = sim, self._start()

    def crash(self) -> None:
        self.service.kill()
        self.service.process.wait()
        self.service = self._start()


@pytest.fixture(scope="module")
def services(
    start_module_service: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory, reserve_ports: Any
) -> Orchestrator:
    sim, ports = start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1"), reserve_ports(["orchestrator"])
    return Orchestrator(start_module_service, tmp_path_factory.mktemp("runs"), sim, ports["orchestrator"])


@pytest.fixture(autouse=True)
def orchestrator(services: Orchestrator, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Orchestrator:
    monkeypatch.setenv("FREEREIN_ORCHESTRATOR_ADDRESS", services.service.address)
    monkeypatch.chdir(tmp_path)
    return services


def _command(words: tuple[str, ...]) -> list[str]:
    return list(words) if words[0] == "run" else ["jobs", *words]


def _run(*words: str) -> Result:
    return CliRunner().invoke(app, _command(words))


def _json(*words: str) -> list[dict[str, Any]]:
    result = _run(*words, "--json")
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()]


@contextmanager
def _hearing_ctrl_c() -> Iterator[None]:
    """What is started meanwhile hears Ctrl-C, although whoever started the tests in the background does not."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _watching(*words: str) -> "Iterator[subprocess.Popen[str]]":
    """A program that watches, once the run has made a step."""
    command = [sys.executable, "-m", "freerein.cli", *_command(words)]
    with _hearing_ctrl_c(), subprocess.Popen(command, stdout=PIPE, stderr=PIPE, text=True, env=os.environ) as child:
        try:
            while " running 0/" in (line := _line(child)) or "queued" in line or '"step": 0' in line:
                pass
            yield child
        finally:
            child.kill()


def test_a_run_is_watched_line_by_line_to_its_end(orchestrator: Orchestrator) -> None:
    watched = _run(*FEW, "--watch")
    lines = watched.stdout.splitlines()
    run_id = lines[-1].split()[0]

    queued_at, ended_at = (datetime.fromisoformat(lines[place].split()[0]) for place in (0, -3))
    assert queued_at <= ended_at
    assert lines[0].endswith(f" run {run_id[:8]} queued 0/3")
    assert f" run {run_id[:8]} succeeded 3/3 timesteps=" in lines[-3]
    _, name, state, *since, steps, _ = lines[-1].split()
    assert (name, state, since[-1], steps, len(run_id)) == ("collect-few", "succeeded", "ago", "3", 8)
    assert "freerein fit segmentation few" in watched.stderr
    link = f"{name}-{run_id[:6]}"
    assert " ago" in _run("artifacts", run_id).stdout
    assert (orchestrator.service.data_dir / "named" / link / "config.json").is_file()
    assert _json("watch", link)[-1]["id"].startswith(run_id)


def test_watching_it_again_tells_the_same_story() -> None:
    first = _json(*FEW, "--watch")

    assert _json("watch", first[0]["id"]) == first
    assert _json("watch", first[0]["id"][:8]) == first
    assert (first[0]["state"], first[-1]["state"]) == ("queued", "succeeded")


def test_the_metrics_of_a_run_are_its_whole_curve_or_a_decimated_one() -> None:
    run_id = _json(*FEW, "--watch")[0]["id"]

    steps = [row["step"] for row in _json("metrics", run_id)]
    assert steps in ([1, 3], [1, 2, 3])  # two rows a second and the last one, of what may be a slow machine
    assert [row["step"] for row in _json("metrics", run_id, "--max-rows", "1")] == [3]
    lines = _run("metrics", run_id, "--from-step", "2").stdout.splitlines()
    assert [line.split()[0] for line in lines] == ["step", *map(str, steps[1:])]


def test_the_same_key_is_the_same_run_and_settings_change_the_file(tmp_path: Path) -> None:
    file = tmp_path / "grid.json"
    file.write_text(json.dumps({"task": "grid", "dataset": "keyed", "count": 3}))
    words = ("run", "collect", "--config", str(file), "--set", "count=2", "--key", "twice")

    (first,), (second,) = _json(*words), _json(*words)

    assert first["id"] == second["id"]
    assert (first["config"]["dataset"], first["config"]["count"]) == ("keyed", 2)
    assert first["id"] in [run["id"] for run in _json("list")]


def test_a_run_that_is_cancelled_is_resumed_to_its_end(orchestrator: Orchestrator) -> None:
    with _watching(*LARGE, "--set", "dataset=resumed", "--json") as child:
        run_id = json.loads(_line(child))["id"]
        orchestrator.sim.process.send_signal(signal.SIGSTOP)  # so that the run does not end before it is cancelled
        try:
            (cancelled,) = _json("cancel", run_id)
            assert child.wait(60) == 1
        finally:
            orchestrator.sim.process.send_signal(signal.SIGCONT)
    *_, resumed = _json("resume", run_id, "--watch")

    assert (cancelled["state"], resumed["state"], resumed["step"]) == ("cancelled", "succeeded", resumed["steps"])
    assert _run("watch", run_id).exit_code == 0  # the end of the first attempt is not the end
    assert _json("rm", run_id[:8]) == [{"run": run_id, "deleted": True}]
    assert run_id not in [run["id"] for run in _json("list")]


def test_a_ppo_run_that_has_succeeded_is_trained_on() -> None:
    *_, first = _json(*PPO, "--watch")
    *_, more = _json("resume", first["id"][:8], "--iterations", "2", "--watch")

    assert more["id"] != first["id"]
    assert more["config"] == {**first["config"], "iterations": 2, "resume_from": first["id"]}
    assert more["metrics"]["timesteps"] == 3 * first["metrics"]["timesteps"]
    assert "--iterations" in _run("resume", first["id"]).stderr


def test_only_ppo_runs_are_trained_on() -> None:
    run_id = _json(*FEW, "--watch")[0]["id"]

    assert _run("resume", run_id, "--iterations", "0").exit_code == 2
    refused = _run("resume", run_id, "--iterations", "2")
    assert (refused.exit_code, "of kind collect" in refused.stderr) == (1, True)


def test_a_watcher_outlives_the_orchestrator(orchestrator: Orchestrator) -> None:
    with _watching(*MANY, "--set", "dataset=outlived", "--json") as child:
        child.send_signal(signal.SIGSTOP)  # it gives up after half a minute, which a start may take
        orchestrator.crash()
        child.send_signal(signal.SIGCONT)
        assert child.stdout is not None
        steps = [json.loads(line)["step"] for line in child.stdout]
        assert child.wait(300) == 0

    assert steps == sorted(steps)
    assert steps[-1] == 150


def test_ctrl_c_leaves_the_run_going_and_says_how_to_come_back() -> None:
    with _watching(*MANY, "--set", "count=100000", "--set", "dataset=left") as child:
        child.send_signal(signal.SIGINT)
        assert child.wait(60) == 130
        assert child.stderr is not None
        again = child.stderr.read().split("`")[1]

    *command, run_id = again.split()
    (left,) = [run for run in _json("list") if run["id"].startswith(run_id)]
    _json("cancel", run_id)
    assert (command, left["state"]) == (["freerein", "jobs", "watch"], "running")


def test_artifacts_are_listed_and_fetched_whole_or_not_at_all(tmp_path: Path) -> None:
    run_id = _json(*FEW, "--watch")[0]["id"]
    (artifact,) = _json("artifacts", run_id)

    fetched = _run("artifacts", run_id, artifact["name"], "--out", str(tmp_path / "card.json"))
    printed = _run("artifacts", run_id, artifact["name"], "--out", "-")
    missing = _run("artifacts", run_id, "nothing")
    into_folder = _run("artifacts", run_id, artifact["name"], "--out", str(tmp_path))

    assert fetched.stdout.startswith(f"{artifact['size']} bytes in ")
    assert (tmp_path / "card.json").read_text() == printed.stdout
    assert (missing.exit_code, into_folder.exit_code) == (1, 0)
    assert {path.name for path in tmp_path.iterdir()} == {"card.json", artifact["name"]}


def test_a_step_that_no_run_can_have_is_a_mistake_of_the_command_line() -> None:
    assert _run("metrics", "0" * 32, "--from-step", str(2**64)).exit_code == 2


@pytest.mark.parametrize(
    ("words", "field"),
    [
        (("run", "collect", "--set", "task"), "set"),
        (("run", "collect", "--config", "list.json"), "config"),
        (("run", "collect", "--set", "colour=red"), "config"),
        (("watch", "0" * 32, "--service", "orchestrator"), "id"),
        (("resume", "no-id", "--service", "orchestrator"), "id"),
    ],
)
def test_what_cannot_be_asked_is_an_error_that_names_the_field(words: tuple[str, ...], field: str) -> None:
    Path("list.json").write_text("[]")
    result = _run(*words, "--json")

    assert result.exit_code == 1
    assert field in json.loads(result.stderr)["error"]["field"]


def _line(child: "subprocess.Popen[str]") -> str:
    assert child.stdout is not None
    return child.stdout.readline()
