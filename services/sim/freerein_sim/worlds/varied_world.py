"""Builds a task's world under conditions."""

import hashlib
from collections.abc import Sequence
from typing import Any, cast

from freerein_sim.worlds.camera_effects import Effect, effects_of
from freerein_sim.worlds.conditions import check_conditions
from freerein_sim.worlds.world import Frame, TaskDefinition, World


def build(task: TaskDefinition, conditions: Sequence[str] = ()) -> World:
    """Returns a world of a task, under conditions that it declares. It must be reset before use.

    Raises:
        InvalidInput: A condition is not the task's, or two are of one group.
    """
    chosen = check_conditions(task.conditions, conditions)
    own = chosen & {condition.name for condition in task.own_conditions}
    world = task.make(conditions=own) if own else task.make()
    return cast(World, _VariedWorld(world, chosen)) if chosen else world


class _VariedWorld:
    """A world that is seen through camera effects, and whose snapshots name its conditions by the fingerprint."""

    def __init__(self, world: World, conditions: frozenset[str]) -> None:
        self._world = world
        self._effects: tuple[Effect, ...] = effects_of(conditions)
        named = " ".join(sorted(conditions))
        self.fingerprint = hashlib.sha256(f"{named} {world.fingerprint}".encode()).hexdigest()

    def render(self, camera: str, *, height: int, width: int) -> Frame:
        """Returns the camera's current image after the effects."""
        frame = self._world.render(camera, height=height, width=width)
        for effect in self._effects:
            frame = effect(frame)
        return frame

    def __getattr__(self, name: str) -> Any:
        """Returns everything else of the world."""
        return getattr(self._world, name)
