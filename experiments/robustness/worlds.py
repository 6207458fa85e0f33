"""The tasks and conditions of the benchmark, and the hash of what they draw."""

import hashlib
from contextlib import closing
from functools import cache

import numpy as np

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

_HASHED_STARTS = 8
_DECIMALS = 6  # other processors round the last bits otherwise


def conditions(task: str) -> tuple[str, ...]:
    """Returns `NOMINAL`, then what a task declares; of numbers of blocks only those in which `blocks` differs."""
    declared = tasks()[task].conditions
    counts = {"blocks-2", "blocks-3"} if task == DEMONSTRATED else set()
    return (NOMINAL, *(each.name for each in declared if each.group != "blocks" or each.name in counts))


def open_world(task: str, *named: str) -> World:
    """Returns a world of a task under conditions, of which `NOMINAL` is none."""
    return build(tasks()[task], [each for each in named if each != NOMINAL])


@cache
def world_hash(task: str) -> str:
    """Returns the sha256 of a task's worlds under each condition, and of states in which episodes start."""
    digest = hashlib.sha256()
    for condition in conditions(task):
        with closing(open_world(task, condition)) as world:
            digest.update(f"{condition} {world.fingerprint}".encode())
            for seed in range(_HASHED_STARTS):
                world.reset(np.random.default_rng(seed))
                digest.update((np.round(world.truth().state, _DECIMALS) + 0.0).tobytes())
    return digest.hexdigest()
