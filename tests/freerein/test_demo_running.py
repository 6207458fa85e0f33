"""What the demo may touch: its own folder and services; and the services that somebody else started, when told to."""

from pathlib import Path

import pytest

from freerein.cli.demo import folder
from freerein.cli.demo.pipeline import environ_of_its_own, run
from freerein.cli.demo.screen import Screen
from freerein.cli.services import running
from freerein.errors import FailedPrecondition, InvalidInput


def test_services_that_run_are_where_the_environment_says_and_else_on_loopback() -> None:
    doors = running(("sim", "reward"), {"FREEREIN_SIM_ADDRESS": "sim:9999"})
    assert doors.addresses == {"sim": "sim:9999", "reward": "127.0.0.1:9103"}
    assert doors.urls == {"sim": "http://sim:8104", "reward": "http://127.0.0.1:8103"}


def test_services_of_the_demos_own_share_in_nobodys_runs() -> None:
    asked = {
        "FREEREIN_DATABASE_URL": "postgresql://somebody",
        "FREEREIN_EXECUTOR_ID": "worker-2",
        "FREEREIN_SIM_ADDRESS": "elsewhere:9104",
        "FREEREIN_QUEUE": "7",
    }
    assert environ_of_its_own(asked) == {"FREEREIN_QUEUE": "7"}


@pytest.mark.parametrize("out", [".", "var", "var/datasets", "var/datasets/new"])
@pytest.mark.parametrize("is_running", [True, False])
async def test_the_demo_does_not_empty_what_holds_the_services_data_or_belongs_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: str, is_running: bool
) -> None:
    kept = tmp_path / "var" / "datasets" / "kept"
    kept.mkdir(parents=True)
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path / "var"))
    with pytest.raises(InvalidInput, match="must not hold the services' data directory"):
        await run(tmp_path / out, seed=0, screen=Screen(as_json=True), running=is_running)
    assert kept.exists()


@pytest.mark.parametrize("held", ["thesis.tex", "data/mine.csv", "summary.json"])
async def test_the_demo_empties_no_folder_that_it_did_not_make(tmp_path: Path, held: str) -> None:
    out = tmp_path / "out"
    (out / held).parent.mkdir(parents=True)
    (out / held).touch()
    with pytest.raises(FailedPrecondition, match="must be new, empty, or an earlier demo's") as error:
        await run(out, seed=0, screen=Screen(as_json=True), running=False)
    assert "--out" in error.value.hint
    assert (out / held).exists()


@pytest.mark.parametrize("left", [folder.MARK, "requests/segment-grid.json", "data/datasets/grid-train/meta/info.json"])
def test_what_an_earlier_demo_left_is_emptied_however_far_it_came(tmp_path: Path, left: str) -> None:
    for name in (left, "summary.json", "data/logs/sim.log"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    folder.begin(tmp_path, keep=None)
    assert [path.name for path in tmp_path.iterdir()] == [folder.MARK]
    (tmp_path / "data" / "begun").mkdir(parents=True)
    folder.begin(tmp_path, keep=tmp_path.parent)
    assert [path.name for path in tmp_path.iterdir()] == [folder.MARK]
