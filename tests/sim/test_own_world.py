"""The template of a world of one's own, installed as its README says, but without pip."""

import shutil
import tomllib
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from freerein.types.sim import DemonstrateRequest
from freerein_sim.workers.demonstrations import make_demonstration
from freerein_sim.worlds import conformance
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import TaskDefinition

TEMPLATE = Path("examples/own_world")


@pytest.fixture(scope="module")
def lamps(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TaskDefinition]:
    folder = tmp_path_factory.mktemp("installed")
    project = tomllib.loads((TEMPLATE / "pyproject.toml").read_text())["project"]
    shutil.copy(TEMPLATE / "own_world.py", folder)
    info = folder / "own_world-1.0.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    worlds = project["entry-points"]["freerein.worlds"]
    (info / "entry_points.txt").write_text(
        "\n".join(["[freerein.worlds]", *(f"{name} = {place}" for name, place in worlds.items())])
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        yield tasks()["lamps"]


@pytest.mark.parametrize("check", [*conformance.CHECKS, *conformance.TAG_CHECKS], ids=lambda check: str(check.__name__))
def test_the_template_conforms(check: Callable[[TaskDefinition], None], lamps: TaskDefinition) -> None:
    check(lamps)


def test_the_template_records_its_expert(lamps: TaskDefinition) -> None:
    assert lamps.describe().has_expert
    with closing(lamps.make()) as world:
        shown = make_demonstration(lamps, world, DemonstrateRequest("lamps", "expert", min_skills=2, privileged=True))

    assert shown.labels is not None
    assert {lamps.spec.skills[label] for label in shown.labels} == set(shown.trajectory.skills)
    assert len(shown.trajectory.frames["top"]) == len(np.asarray(shown.trajectory.actions)) > 4
