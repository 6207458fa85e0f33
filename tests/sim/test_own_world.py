"""The template of a world of one's own, once it is installed."""

from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
import pytest
from tests.own_world import install_template

from freerein.types.sim import DemonstrateRequest
from freerein_sim.workers.demonstrations import make_demonstration
from freerein_sim.worlds import conformance
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import TaskDefinition


@pytest.fixture(scope="module")
def lamps(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TaskDefinition]:
    folder = tmp_path_factory.mktemp("installed")
    install_template(folder)
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
