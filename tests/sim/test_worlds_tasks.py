from pathlib import Path

import pytest

from freerein.errors import AlreadyExists, InvalidInput
from freerein_sim.worlds.grid import SPEC, GridWorld
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import TaskDefinition


def install(folder: Path, module: str, task: str) -> None:
    """Puts a package that offers one task where Python looks for packages."""
    (folder / f"{module}.py").write_text(
        "from freerein_sim.worlds.grid import SPEC, GridWorld\n"
        "from freerein_sim.worlds.world import TaskDefinition\n"
        f"TASKS = (TaskDefinition({task!r}, 'maze', '', SPEC, GridWorld),)\n"
    )
    info = folder / f"{module}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[freerein.worlds]\n{module} = {module}:TASKS\n")


def test_the_built_in_tasks_are_found_by_name() -> None:
    found = tasks()

    assert {"grid", "grid-no-indicator", "blocks", "blocks.red-on-top-of-blue"} <= set(found)
    assert all(name == task.name for name, task in found.items())


def test_an_installed_package_adds_a_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "world_of_mazes", "maze")
    monkeypatch.syspath_prepend(tmp_path)

    assert tasks()["maze"].world == "maze"


def test_two_packages_cannot_offer_one_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "world_of_grids", "grid")
    monkeypatch.syspath_prepend(tmp_path)

    with pytest.raises(AlreadyExists, match="grid is offered twice"):
        tasks()


def test_a_task_of_an_illegal_name_cannot_be_made() -> None:
    with pytest.raises(InvalidInput, match="`task` must be"):
        TaskDefinition("Grid World", "grid", "", SPEC, lambda: GridWorld(indicator=True))
