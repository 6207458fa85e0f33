from collections.abc import Callable
from dataclasses import replace

import pytest

from freerein_sim.worlds import blocks, conformance, grid, pendulum
from freerein_sim.worlds.replay import ReplayedWorld
from freerein_sim.worlds.world import TaskDefinition

REPLAYED = replace(grid.TASKS[0], name="replayed", make=lambda: ReplayedWorld(grid.GridWorld(indicator=True)))
TASKS = {task.name: task for task in (*grid.TASKS, *blocks.TASKS, *pendulum.TASKS, REPLAYED)}
CHECKED = (
    "grid",
    "replayed",
    "pendulum",
    "grid-no-indicator",
    "blocks",
    "blocks.scatter",
    "blocks.red-left-of-green",
    "blocks.yellow-right-of-blue",
    "blocks.blue-on-top-of-red",
)


@pytest.mark.parametrize("task", [TASKS[name] for name in CHECKED], ids=CHECKED)
@pytest.mark.parametrize("check", conformance.CHECKS, ids=[check.__name__ for check in conformance.CHECKS])
def test_our_worlds_conform(check: Callable[[TaskDefinition], None], task: TaskDefinition) -> None:
    check(task)


def test_a_check_names_what_a_world_does_wrong() -> None:
    mislabelled = TaskDefinition("wrong", "blocks", "", grid.SPEC, TASKS["blocks"].make)

    with pytest.raises(AssertionError, match=r"The world's spec is the task's\."):
        conformance.describes_itself(mislabelled)
