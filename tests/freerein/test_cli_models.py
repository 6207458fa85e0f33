"""`freerein models` as a user types it: which models the learned services have, and on what they were trained."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from freerein.cli.__main__ import app

pytestmark = pytest.mark.e2e
SHIPPED = Path(__file__).parents[2] / "models"
LEARNED = ("segmentation", "imitation", "reward")


@pytest.fixture(autouse=True)
def _no_service_runs(monkeypatch: pytest.MonkeyPatch, reserve_ports: Any) -> None:
    for service, ports in reserve_ports(LEARNED).items():
        monkeypatch.setenv(f"FREEREIN_{service.upper()}_ADDRESS", f"127.0.0.1:{ports.grpc}")


@pytest.fixture
def imitation(start_service: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """The imitation service with the shipped models."""
    service = start_service("freerein_imitation")
    monkeypatch.setenv("FREEREIN_IMITATION_ADDRESS", service.address)


def _run(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


@pytest.mark.usefixtures("imitation")
def test_models_of_every_service_that_answers_are_listed_with_their_data() -> None:
    models = [json.loads(line) for line in _run("models", "list", "--json").stdout.splitlines()]
    shipped = sorted(path.parent.name for path in (SHIPPED / "imitation").glob("*/active.json"))
    assert [(model["service"], model["ref"]["name"]) for model in models] == [("imitation", name) for name in shipped]

    result = _run("models", "list")
    lines = result.stdout.splitlines()
    assert lines[0].split() == ["service", "model", "version", "made", "dataset"]
    for model, line in zip(models, lines[1:], strict=True):
        data = model["card"]["data"]
        assert line.split()[:4] == ["imitation", *model["ref"].values(), "active"]
        assert f"{model['card']['task']}, {data['trajectories']} trajectories, {data['fingerprint'][:12]}" in line
    assert "segmentation, reward" in result.stderr


@pytest.mark.parametrize("words", [("--service", "reward"), ()])
def test_where_no_service_answers_the_list_is_an_error(words: tuple[str, ...]) -> None:
    result = _run("models", "list", *words, "--json")
    assert result.exit_code == 1
    assert json.loads(result.stderr)["error"]["code"] == "unavailable"
