"""Predicates of worlds in which a gripper moves objects, on true positions in metres."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from freerein_sim.worlds.predicates import AT_LANDMARK, OBJECT_MOVES, Flags, StatePredicate, States

TOLERANCE_M = 0.025
"""How far gripper and objects may be from where a landmark has them."""


class MovedObjects:
    """The predicates of landmarks and of lifted objects.

    Args:
        state_names: Name of each number of the true state.
        gripper_axes: Axes of the gripper's position among them, such as `yz`.
        names: Names of the objects.
        lifted_m: Least rise of a lifted object.

    Attributes:
        gripper: Indices of the gripper's position.
        objects: int64 (objects, 3), indices of the objects' positions.
    """

    def __init__(
        self, state_names: Sequence[str], *, gripper_axes: str, names: Sequence[str], lifted_m: float = 0.02
    ) -> None:
        self.gripper = [state_names.index(f"gripper.{axis}") for axis in gripper_axes]
        self.objects = np.array([[state_names.index(f"{name}.{axis}") for axis in "xyz"] for name in names])
        self._lifted_m = lifted_m

    def landmarks(self) -> tuple[StatePredicate, ...]:
        """Returns the predicates of landmarks."""
        return (
            StatePredicate(AT_LANDMARK, self._is_at, needs_reference=True),
            StatePredicate(OBJECT_MOVES, self._is_moved, needs_reference=True),
        )

    def predicates(
        self, skills: Mapping[str, int], is_completed: Callable[[int, States], Flags]
    ) -> tuple[StatePredicate, ...]:
        """Returns the predicates of landmarks, and `lifted/SKILL` and `completed/SKILL` by the index of its object."""
        return (
            *self.landmarks(),
            *(StatePredicate(f"lifted/{skill}", partial(self.is_lifted, index)) for skill, index in skills.items()),
            *(StatePredicate(f"completed/{skill}", partial(is_completed, index)) for skill, index in skills.items()),
        )

    def is_lifted(self, index: int, states: States) -> Flags:
        """Returns whether an object has risen since the first state."""
        height = states[..., self.objects[index, 2]]  # (N, T)
        return np.asarray(np.maximum.accumulate(height, axis=1) - height[:, :1] > self._lifted_m)

    def _is_at(self, states: States, references: States) -> Flags:
        """The gripper may be off by the tolerance along each axis, and each object in all."""
        off = np.abs(states[..., self.gripper] - references[..., self.gripper]).max(axis=-1)  # (N, T)
        return np.asarray((off <= TOLERANCE_M) & ~self._is_moved(states, references))

    def _is_moved(self, states: States, references: States) -> Flags:
        moved = np.linalg.norm(states[..., self.objects] - references[..., self.objects], axis=-1)  # (N, T, objects)
        return np.asarray(moved.max(axis=-1) > TOLERANCE_M)
