"""The demo with services that somebody else started."""

from pathlib import Path

import pytest

from freerein.cli.demo.pipeline import run
from freerein.cli.demo.screen import Screen
from freerein.cli.services import running
from freerein.errors import InvalidInput


def test_services_that_run_are_where_the_environment_says_and_else_on_loopback() -> None:
    doors = running(("sim", "reward"), {"FREEREIN_SIM_ADDRESS": "sim:9999"})
    assert doors.addresses == {"sim": "sim:9999", "reward": "127.0.0.1:9103"}
    assert doors.urls == {"sim": "http://sim:8104", "reward": "http://127.0.0.1:8103"}


async def test_the_demo_does_not_empty_a_folder_that_holds_the_services_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = tmp_path / "var" / "kept"
    kept.mkdir(parents=True)
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path / "var"))
    with pytest.raises(InvalidInput, match="must not hold the services' data directory"):
        await run(tmp_path, seed=0, screen=Screen(as_json=True), running=True)
    assert kept.exists()
