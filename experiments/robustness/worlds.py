"""The tasks and conditions of the benchmark."""

from functools import cache

from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.world import World

DEMONSTRATED, SCATTERED = "blocks", "blocks.scatter"
"""Tasks of the demonstrations, and of the scenes that rewards are judged in."""

CAMERA = "front"
NOMINAL = "nominal"
"""No condition."""

BLOCKS = ("blocks-2", "blocks-4")
"""Numbers of blocks of the scenes, each a condition beside another."""

CURRICULUM, NEAR = "start-on-the-way", "start-near"
"""A condition to learn under: no policy need hold under it."""


DISTRACTORS = ("ball", "picture")
"""Conditions of the scenes in which a thing that is no block has the colour of one."""


@cache
def conditions(task: str) -> tuple[str, ...]:
    """Returns `NOMINAL`, then what a task declares but distractors; of numbers of blocks those `blocks` differs in."""
    declared = [each for each in tasks()[task].conditions if each.name not in (CURRICULUM, NEAR, *DISTRACTORS)]
    counts = {"blocks-2", "blocks-3"} if task == DEMONSTRATED else set()
    return (NOMINAL, *(each.name for each in declared if each.group != "blocks" or each.name in counts))


def open_world(task: str, *named: str) -> World:
    """Returns a world of a task under conditions, of which `NOMINAL` is none."""
    return build(tasks()[task], [each for each in named if each != NOMINAL])
