"""The dissertation's navigation in offices (chapter 3, appendix A): a wheeled robot with a camera, in MuJoCo.

Data are collected on the floors `office` and `office.2`; `office.3` validates, and `office.4` is for claims. Each
has rooms, furniture and textures of its own. Nothing is simulated but where the robot is and what it runs into.
"""

from collections.abc import Collection
from functools import partial

from freerein_sim.worlds.office.floors import FLOORS
from freerein_sim.worlds.office.predicates import predicates_of
from freerein_sim.worlds.office.spec import CONDITIONS, EXPLORATION, SPEC
from freerein_sim.worlds.opengl import check_mujoco_gl
from freerein_sim.worlds.recipes import RandomOrder
from freerein_sim.worlds.repeated_choices import repeat_choices
from freerein_sim.worlds.world import TaskDefinition, World

VERSION = 1
"""Version of the world; raised where it behaves differently."""


def _make(floor: str, conditions: Collection[str] = ()) -> World:
    check_mujoco_gl()
    from freerein_sim.worlds.office import expert, simulation

    return simulation.OfficeWorld(floor, expert.OfficeExpert, conditions)


def _task(floor: str) -> TaskDefinition:
    return TaskDefinition(
        floor,
        "office",
        "",
        SPEC,
        partial(_make, floor),
        predicates_of(FLOORS[floor]),
        CONDITIONS,
        RandomOrder(most=1),
        version=VERSION,
        explorer=partial(repeat_choices, EXPLORATION),
        reward_free=True,
    )


TASKS = tuple(map(_task, FLOORS))
"""The office world in MuJoCo."""
