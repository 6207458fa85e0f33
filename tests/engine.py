"""What runs only where the engine of the world `doom` is installed."""

import importlib.util

import pytest

from freerein_sim.worlds.world import TaskDefinition

_IS_MISSING = importlib.util.find_spec("vizdoom") is None
_REASON = "needs ViZDoom: pip install --no-deps -r assets-doom.txt"

needs_engine = pytest.mark.skipif(_IS_MISSING, reason=_REASON)


def skip_without_engine(task: TaskDefinition) -> None:
    """Skips the test where the task's world needs the engine, and it is missing."""
    if task.world == "doom" and _IS_MISSING:
        pytest.skip(_REASON)
