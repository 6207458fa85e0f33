"""Commands as a user types them: their help, their JSON, their errors."""

import importlib.util
import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from freerein.cli.__main__ import COMMANDS, app
from freerein.cli.doctor import machine, services
from freerein.cli.jobs.options import configuration, setting
from freerein.cli.segments.timeline import skill_bar
from freerein.data import DatasetSpec, create
from freerein.errors import InvalidInput
from freerein.ports import PORTS, Ports
from freerein.types.common import ActionSpec, Trajectory

_SPEC = DatasetSpec(
    fps=10, cameras={"top": (4, 5, 3)}, action=ActionSpec(2, 0, ("x", "y")), robot_type="arm", skills=("pick", "place")
)


@pytest.fixture
def data_dir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data directory with the dataset `demos`, of two trajectories."""
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    with create(tmp_path / "datasets" / "demos", _SPEC) as writer:
        for skill in _SPEC.skills:
            frames = {"top": np.zeros((3, 4, 5, 3), np.uint8)}
            writer.append(Trajectory(frames, np.zeros((3, 2), np.float32), (skill,)))
    return tmp_path


@pytest.fixture
def nobody_listens(monkeypatch: pytest.MonkeyPatch, reserve_ports: Any) -> Ports:
    """The sim service's ports, moved to where nobody listens."""
    ports: Ports = reserve_ports(["sim"])["sim"]
    monkeypatch.setitem(PORTS, "sim", ports)
    return ports


@pytest.fixture
def listener() -> Iterator[int]:
    """A port that somebody holds who says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def _run(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


def test_help_answers_at_once_because_nothing_heavy_is_imported() -> None:
    script = (
        "import freerein.cli.__main__, sys; print(sorted({'numpy', 'grpc', 'httpx', 'pyarrow'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)

    assert done.stdout == "[]\n"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_the_help_that_the_list_of_commands_says(name: str) -> None:
    result = _run(name, "--help")

    assert result.exit_code == 0
    assert f" {name} [OPTIONS]" in result.output
    assert COMMANDS[name] in " ".join(result.output.split())


def test_inspect_prints_a_dataset_as_json(data_dir: Path) -> None:
    document = json.loads(_run("dataset", "inspect", "demos", "--json").stdout)

    assert document["trajectories"] == 2
    assert document["skill_counts"] == {"pick": 1, "place": 1}


def test_a_whole_dataset_is_verified_and_fit_for_training(data_dir: Path) -> None:
    for name in ("verify", "check"):
        result = _run("dataset", name, "demos", "--json")
        problems = json.loads(result.stdout)["problems"]
        assert (result.exit_code, [each for each in problems if each["severity"] == "error"]) == (0, [])
    assert list(json.loads(result.stdout)["fit"]) == ["camera", "frame", "minutes", "memory_gb", "disk_gb"]
    said = _run("dataset", "check", "demos").stdout
    assert "of the camera top. It takes about 1 min, by a plain estimate" in said


def test_a_dataset_is_imported_under_a_new_name_and_other_sizes(data_dir: Path) -> None:
    source = str(data_dir / "datasets" / "demos")
    imported = json.loads(_run("dataset", "import", source, "small", "--size", "2x3", "--json").stdout)
    document = json.loads(_run("dataset", "inspect", "small", "--json").stdout)
    assert (imported["imported"], document["spec"]["cameras"]) == (2, {"top": [2, 3, 3]})
    for words, code in (
        ([source, "small"], "already_exists"),
        ([source, "x", "--size", "3"], "invalid_input"),
        ([str(data_dir), "x"], "not_found"),
    ):
        refused = json.loads(_run("dataset", "import", *words, "--json").stderr)
        assert refused["error"]["code"] == code
    assert "--layout mime" in refused["error"]["hint"]


def test_the_list_names_the_datasets(data_dir: Path) -> None:
    assert json.loads(_run("dataset", "list", "--json").stdout) == {"datasets": ["demos"]}
    header, row = _run("dataset", "list").stdout.splitlines()
    assert header.split() == ["dataset", "changed"]
    assert (row.split()[0], row.split()[-1]) == ("demos", "ago")


def test_an_error_is_one_sentence_and_a_hint_on_stderr(data_dir: Path) -> None:
    result = _run("dataset", "inspect", "nothing")

    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert "\nhint:  " in result.stderr


def test_a_service_that_does_not_run_is_an_error_that_names_up(data_dir: Path, nobody_listens: Ports) -> None:
    result = _run("sim", "tasks", "--json")

    assert result.exit_code == 1
    assert "`freerein up`" in json.loads(result.stderr)["error"]["hint"]


def test_settings_are_json_where_they_can_be_and_text_elsewhere() -> None:
    assert dict(map(setting, ["updates=200", "objective=mil", "rates=[0.1]"])) == {
        "updates": 200,
        "objective": "mil",
        "rates": [0.1],
    }
    with pytest.raises(InvalidInput, match="KEY=VALUE"):
        setting("updates")


def test_a_setting_of_a_text_is_not_read_as_a_number() -> None:
    given = ["model=default", "version=12e456789012", "count=20", "dataset=20261105", 'camera="front"']
    assert configuration("label", given) == {
        "model": "default",
        "version": "12e456789012",
        "count": 20,
        "dataset": "20261105",
        "camera": "front",
    }


def test_the_bar_shows_every_skill_at_its_place_and_never_grows_wider_than_asked() -> None:
    assert skill_bar([0, 0, 1, 2], width=80).plain == "AABC"
    assert skill_bar([0] * 50 + [1] * 50, width=10).plain == "AAAAABBBBB"
    assert skill_bar([0, -1, -1, 1], width=80).plain == "A··B"


def test_the_doctor_says_how_to_start_a_service_that_does_not_run(nobody_listens: Ports) -> None:
    (check,) = services.checks(["sim"])
    result = check()

    assert (result.state, result.fix) == ("warning", "Run `freerein up`.")


def test_the_doctor_asks_what_is_installed_and_what_the_environment_says_where(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREEREIN_REWARD_ADDRESS", "elsewhere:9103")
    assert services.expected(["sim"], ()) == ["reward", "sim"]
    assert services.expected(["sim"], ["segmentation"]) == ["segmentation"]
    with pytest.raises(InvalidInput, match="one of orchestrator, "):
        services.expected(["sim"], ["simulator"])


def test_the_doctor_recognises_a_port_that_another_program_holds(
    nobody_listens: Ports, listener: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PORTS, "sim", Ports(listener, nobody_listens.grpc))

    (check,) = services.checks(["sim"])
    result = check()

    assert result.state == "problem"
    assert str(listener) in result.detail


def test_the_doctor_says_that_a_host_is_no_address_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREEREIN_HOST", "192.0.2.1")  # of no machine
    (check,) = services.checks(["sim"])

    assert (check().state, check().fix) == ("problem", "Correct FREEREIN_HOST.")


def test_the_doctor_finds_the_wheels_that_are_data() -> None:
    found = [*machine.check_wheels("sim"), *machine.check_wheels("imitation")]
    assert [(each.name, each.state) for each in found] == [
        ("robot meshes", "ok"),
        ("pendulum model", "ok"),
        ("robot arm", "ok"),
        ("robots", "ok"),
        ("engine", "ok" if importlib.util.find_spec("vizdoom") else "warning"),
        ("text encoder", "ok"),
    ]


def test_the_doctor_makes_and_measures_the_data_directory(tmp_path: Path) -> None:
    results = machine.check_storage(tmp_path / "new")

    assert [result.name for result in results] == ["data directory", "disk", "disk sync"]
    assert results[0].state == "ok"


def test_the_doctor_says_where_it_cannot_write(tmp_path: Path) -> None:
    (tmp_path / "file").touch()

    (result,) = machine.check_storage(tmp_path / "file" / "below")

    assert result.state == "problem"
    assert "FREEREIN_DATA_DIR" in result.fix
