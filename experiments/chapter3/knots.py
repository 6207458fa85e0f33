"""Knots among the random displacements of `rope`: collected trajectories are made again, and their states judged."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.data import Dataset
from freerein.errors import FailedPrecondition
from freerein_sim.worlds.generators import generator
from freerein_sim.worlds.random_policy import explorer_of
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import TaskDefinition, World

DISPLACEMENTS, KNOTS = "displacements", "knots"
_PREDICATE = "knot"
_EVERY = 5
"""Every fifth trajectory: a rope takes as long to simulate again as it took before, a minute for 500 to 900 actions."""

_MAX_TRIES = 10


def count(collected: Mapping[str, Any], dataset: Dataset) -> dict[str, float]:
    """Returns how many displacements were made again, and how many of them left a knot that was not there before.

    Raises:
        FailedPrecondition: The trajectories that are made again are others.
    """
    task = tasks()[collected["task"]]
    (predicate,) = (each for each in task.predicates if each.name == _PREDICATE)
    world, made, knots = task.make(), 0, 0
    for index in range(0, len(dataset), _EVERY):
        rng = generator(np.random.SeedSequence(collected.get("seed", 0), spawn_key=(index,)))
        states = _again(task, world, rng, dataset.actions(index))
        is_knotted = predicate.holds(states[None])[0]
        made += len(states) - 1
        knots += int((is_knotted[1:] & ~is_knotted[:-1]).sum())
    return {DISPLACEMENTS: float(made), KNOTS: float(knots)}


def _again(
    task: TaskDefinition, world: World, rng: np.random.Generator, actions: npt.NDArray[Any]
) -> npt.NDArray[np.float64]:
    """Returns the states of a trajectory, float64 (T + 1, S), as `make_demonstration` of the sim service makes it."""
    for _ in range(_MAX_TRIES):
        world.reset(rng)
        explorer, states, is_same = explorer_of(task, world, rng), [world.truth().state], True
        for action in actions:
            chosen = explorer.act()
            is_same &= chosen is not None and np.array_equal(chosen.action, action)
            if chosen is None:
                break
            result = world.step(chosen.action)
            states.append(world.truth().state)
            is_same &= not result.diverged
            if result.terminated:
                break
        if is_same:
            return np.array(states)
    raise FailedPrecondition("A trajectory must be made again as it was recorded; its actions are others.")
