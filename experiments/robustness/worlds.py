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

_HASHED_EPISODES, _HASHED_STEPS = 8, 3
_DECIMALS, _BUILD_DECIMALS = 4, 6
"""Of metres: processors round last bits in their own ways, and contacts let these grow."""


CURRICULUM = "start-on-the-way"
"""A condition to learn under: no policy need hold under it."""


def conditions(task: str) -> tuple[str, ...]:
    """Returns `NOMINAL`, then what a task declares; of numbers of blocks only those in which `blocks` differs."""
    declared = [each for each in tasks()[task].conditions if each.name != CURRICULUM]
    counts = {"blocks-2", "blocks-3"} if task == DEMONSTRATED else set()
    return (NOMINAL, *(each.name for each in declared if each.group != "blocks" or each.name in counts))


def open_world(task: str, *named: str) -> World:
    """Returns a world of a task under conditions, of which `NOMINAL` is none."""
    return build(tasks()[task], [each for each in named if each != NOMINAL])


@cache
def world_hash(task: str) -> str:
    """Returns the sha256 of a task's conditions, and of short episodes under each; equal on all machines."""
    digest = hashlib.sha256()
    for condition in conditions(task):
        with closing(open_world(task, condition)) as world:
            digest.update(condition.encode())
            for seed in range(_HASHED_EPISODES):
                world.reset(np.random.default_rng(seed))
                for _ in range(_HASHED_STEPS):
                    world.step(np.zeros(world.spec.action.size, np.float32))
                digest.update((np.round(world.truth().state, _DECIMALS) + 0.0).tobytes())
    return digest.hexdigest()


@cache
def build_hash(task: str) -> str:
    """Returns the sha256 of a task's worlds as this machine builds them, on which drawn pixels depend."""
    digest = hashlib.sha256()
    for condition in conditions(task):
        with closing(open_world(task, condition)) as world:
            digest.update(f"{condition} {world.fingerprint}".encode())
            for seed in range(_HASHED_EPISODES):
                world.reset(np.random.default_rng(seed))
                digest.update((np.round(world.truth().state, _BUILD_DECIMALS) + 0.0).tobytes())
    return digest.hexdigest()
