import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from freerein.errors import AlreadyExists, FailedPrecondition, InvalidInput
from freerein_sim.worlds.bins import scene as bins_scene
from freerein_sim.worlds.blocks import scene as blocks_scene
from freerein_sim.worlds.grid import SPEC, GridWorld
from freerein_sim.worlds.push import scene as push_scene
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import TaskDefinition

LIST_AND_MAKE = """
import sys
from freerein_sim.worlds.tasks import tasks
found = tasks()
for task in found.values():
    task.describe()
assert "mujoco" not in sys.modules
for name in ("blocks", "dial", "pendulum"):
    found[name].make()
assert not {"dm_control", "gymnasium", "gymnasium_robotics"} & sys.modules.keys()
"""


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


def test_two_packages_cannot_offer_one_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "world_of_grids", "grid")
    monkeypatch.syspath_prepend(tmp_path)

    with pytest.raises(AlreadyExists, match="grid is offered twice"):
        tasks()


def test_a_task_of_an_illegal_name_cannot_be_made() -> None:
    with pytest.raises(InvalidInput, match="`task` must be"):
        TaskDefinition("Grid World", "grid", "", SPEC, lambda: GridWorld(indicator=True))


def test_listing_tasks_needs_no_simulator_and_wheels_that_have_assets_are_never_imported() -> None:
    assert subprocess.run([sys.executable, "-c", LIST_AND_MAKE], check=False).returncode == 0


@pytest.mark.fault("R6")
@pytest.mark.parametrize(
    ("package", "build", "listed_in"),
    [
        ("gymnasium_robotics", partial(blocks_scene.build.__wrapped__, ("red",)), "assets.txt"),
        ("robosuite", bins_scene.build.__wrapped__, "assets-robots.txt"),
        ("robosuite", partial(push_scene.build.__wrapped__, ()), "assets-robots.txt"),
    ],
)
def test_a_missing_wheel_is_named_with_the_command_that_installs_it(
    package: str, build: Callable[[], object], listed_in: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)

    with pytest.raises(FailedPrecondition, match=package.replace("_", "-")) as caught:
        build()

    assert caught.value.hint == f"pip install --no-deps -r {listed_in}"
