"""Runs in a world that cannot save its state, as of another package: the same as in one that can."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from freerein.data import Dataset, dataset_path

pytestmark = pytest.mark.e2e
MODULE = """
from dataclasses import replace

from freerein_sim.worlds import grid
from freerein_sim.worlds.replay import ReplayedWorld


class Unsaved(grid.GridWorld):
    snapshot = restore = None


TASKS = (replace(grid.TASKS[0], name="replayed", make=lambda: ReplayedWorld(Unsaved(indicator=True))),)
"""
RANDOM = {"dataset": "random", "behaviour": "random", "count": 4}


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A folder with a package that offers the task `replayed`."""
    folder = tmp_path_factory.mktemp("packages")
    (folder / "unsaved_world.py").write_text(MODULE)
    info = folder / "unsaved_world-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: unsaved_world\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[freerein.worlds]\nunsaved_world = unsaved_world:TASKS\n")
    return str(folder)


@pytest.fixture(scope="module")
def sim(start_module_service: Callable[..., Any], packages: str) -> str:
    """Address of a sim that offers `replayed` and `grid`."""
    return str(start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1", PYTHONPATH=packages).address)


def test_a_dataset_holds_the_same(new_run: Callable[..., Any], sim: str, tmp_path: Path) -> None:
    found = {}
    for task in ("grid", "replayed"):
        assert new_run(tmp_path / task, "collect", {**RANDOM, "task": task}, FREEREIN_SIM_ADDRESS=sim).do()
        dataset = Dataset(dataset_path(tmp_path / task, "random"))
        found[task] = [(each.frames["top"].tobytes(), each.actions.tobytes()) for each in dataset]
    assert len(found["grid"]) == RANDOM["count"]
    assert found["replayed"] == found["grid"]
