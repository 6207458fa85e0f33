"""Runs in a world that cannot save its state, as of another package: the same as in one that can, failures or not."""

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
PPO = {
    "reward": "oracle",
    "encoder": "spatial",
    "iterations": 2,
    "num_envs": 2,
    "num_steps": 10,
    "epochs": 1,
    "batch_size": 10,
    "hidden_size": 8,
    "feature_size": 8,
}
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
def sim(mortal: Callable[..., Any], packages: str) -> Any:
    """A sim that offers `replayed` and `grid`, and may be killed."""
    return mortal("freerein_sim", FREEREIN_SIM_WORKERS="1", PYTHONPATH=packages)


@pytest.fixture
def expect(new_run: Callable[..., Any], sim: Any, tmp_path: Path) -> Callable[..., Any]:
    """A function that finishes a run in the world `grid`."""

    def finish_run(kind: str, config: dict[str, Any]) -> Any:
        run = new_run(tmp_path / "expected", kind, {**config, "task": "grid"}, FREEREIN_SIM_ADDRESS=sim.address)
        assert run.do()
        return run

    return finish_run


@pytest.fixture
def finish(new_run: Callable[..., Any], sim: Any, tmp_path: Path) -> Callable[..., Any]:
    """A function that finishes a run in the world `replayed`; its sim may be replaced at a call after its first row."""

    def finish_run(kind: str, config: dict[str, Any], *, replaced_at: int = 0) -> Any:
        run = new_run(tmp_path, kind, {**config, "task": "replayed"}, FREEREIN_SIM_ADDRESS=sim.address)
        replacing = sim.replaced_at(replaced_at, since=lambda: run.rows)
        assert run.do(stop=replacing if replaced_at else bool)
        assert replacing.is_done or not replaced_at
        return run

    return finish_run


def trajectories(data_dir: Path, dataset: str) -> list[tuple[bytes, bytes]]:
    found = Dataset(dataset_path(data_dir, dataset))
    return [(each.frames["top"].tobytes(), each.actions.tobytes()) for each in found]


def test_a_dataset_holds_the_same(finish: Callable[..., Any], expect: Callable[..., Any]) -> None:
    found = trajectories(finish("collect", RANDOM).data_dir, "random")
    assert len(found) == RANDOM["count"]
    assert found == trajectories(expect("collect", RANDOM).data_dir, "random")


def test_ppo_ends_with_the_same_weights(finish: Callable[..., Any], expect: Callable[..., Any]) -> None:
    found = finish("ppo", PPO, replaced_at=5)
    assert sum(row["recoveries"] for row in found.rows) > 0
    assert found.artifact("policy.json")["sha256"] == expect("ppo", PPO).artifact("policy.json")["sha256"]
