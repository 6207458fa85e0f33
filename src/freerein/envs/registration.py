"""The ids under which Gymnasium makes environments: `freerein/TASK-v0` for the task TASK of the sim service."""

from itertools import permutations

import gymnasium

_RELATIONS = ("left-of", "on-top-of", "right-of")
_PAIRS = tuple(permutations(("blue", "green", "red", "yellow"), 2))
_BLOCKS = tuple(f"blocks.{first}-{relation}-{second}" for first, second in _PAIRS for relation in _RELATIONS)
_PUSH = tuple(f"push.{first}-close-to-{second}" for first, second in _PAIRS if (first, second) != ("blue", "yellow"))

TASKS = (
    *("bins", "bins.uneven", "blocks", "blocks.scatter", "dial", "dial.uneven", "doom", "doom.b", "doom.v1", "doom.v2"),
    *("grid", "grid-no-indicator", "office", "office.2", "office.3", "office.4", "pendulum", "push", "push.scatter"),
    *("rope", "tabletop", "tabletop.only-own-objects"),
    *(*_BLOCKS, *_PUSH),
)
"""The tasks that come with freerein."""


def register(*tasks: str) -> None:
    """Registers tasks of the sim service, such as those of worlds that another package adds.

    `gymnasium.make` takes the keyword arguments of `SimEnv` but the task, `gymnasium.make_vec` those of `SimVectorEnv`.

    Args:
        tasks: Task names.
    """
    for task in tasks:
        gymnasium.register(
            f"freerein/{task}-v0",
            entry_point="freerein.envs:SimEnv",
            vector_entry_point="freerein.envs:SimVectorEnv",
            kwargs={"task": task},
        )
