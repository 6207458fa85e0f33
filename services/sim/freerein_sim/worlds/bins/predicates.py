"""Predicates of the bins task, on true positions in metres."""

from functools import partial

import numpy as np

from freerein_sim.worlds.bins.layout import COMPARTMENT_HALF_M, FLOOR_M, GROCERIES, Grocery, Place
from freerein_sim.worlds.predicates import AT_LANDMARK, OBJECT_MOVES, Flags, StatePredicate, States
from freerein_sim.worlds.world import WorldSpec

TOLERANCE_M = 0.025
"""How far gripper and groceries may be from where a landmark has them."""

LIFTED_M = 0.03
"""Least rise of a lifted grocery."""

_RESTING_M = 0.01
_RELEASED_M = 0.012
_AWAY_M = 0.12


class BinPredicates:
    """Makes the task's predicates from the names of its true state."""

    def __init__(self, spec: WorldSpec) -> None:
        names = spec.state_names
        self._gripper = [names.index(f"gripper.{axis}") for axis in "xyz"]
        self._opening = names.index("gripper.opening")
        self._groceries = np.array([[names.index(f"{each.name}.{axis}") for axis in "xyz"] for each in GROCERIES])

    def all(self) -> tuple[StatePredicate, ...]:
        """Returns the predicates of landmarks and of each skill `move-GROCERY`."""
        numbered = tuple(enumerate(GROCERIES))
        return (
            StatePredicate(AT_LANDMARK, self._is_at, needs_reference=True),
            StatePredicate(OBJECT_MOVES, self._is_moved, needs_reference=True),
            *(StatePredicate(f"lifted/move-{each.name}", partial(self._is_lifted, i)) for i, each in numbered),
            *(StatePredicate(f"completed/move-{each.name}", partial(self._is_completed, i)) for i, each in numbered),
        )

    def _is_at(self, states: States, references: States) -> Flags:
        off = np.abs(states[..., self._gripper] - references[..., self._gripper]).max(axis=-1)  # (N, T)
        return np.asarray((off <= TOLERANCE_M) & ~self._is_moved(states, references))

    def _is_moved(self, states: States, references: States) -> Flags:
        moved = np.linalg.norm(states[..., self._groceries] - references[..., self._groceries], axis=-1)
        return np.asarray(moved.max(axis=-1) > TOLERANCE_M)

    def _is_lifted(self, index: int, states: States) -> Flags:
        height = states[..., self._groceries[index, 2]]  # (N, T)
        return np.asarray(np.maximum.accumulate(height, axis=1) - height[:, :1] > LIFTED_M)

    def _is_completed(self, index: int, states: States) -> Flags:
        """The grocery lay elsewhere in the first state, and now lies in its compartment, released."""
        lies = is_placed(
            GROCERIES[index],
            states[..., self._groceries[index]],
            gripper=states[..., self._gripper],
            opening_m=states[..., self._opening],
        )  # (N, T)
        began = is_in_compartment(GROCERIES[index], states[:, :1, self._groceries[index]])
        return np.asarray(lies & ~began)


def is_in_compartment(grocery: Grocery, at: Place) -> Flags:
    """Returns whether the grocery's origin, float64 (..., 3), is low between the walls of its compartment."""
    off = np.abs(at[..., :2] - grocery.compartment_m)
    low = at[..., 2] < FLOOR_M + grocery.below_m + _RESTING_M
    return np.asarray((off < COMPARTMENT_HALF_M).all(axis=-1) & low)


def is_placed(grocery: Grocery, at: Place, *, gripper: Place, opening_m: States) -> Flags:
    """Returns whether the grocery lies in its compartment, and not between closed fingers.

    Args:
        grocery: Which.
        at: Its origin, float64 (..., 3).
        gripper: Where the gripper is, float64 (..., 3).
        opening_m: Distance between the fingers, float64 (...).
    """
    away = np.linalg.norm(gripper - at, axis=-1) > _AWAY_M
    return np.asarray(is_in_compartment(grocery, at) & (away | (opening_m > grocery.width_m + _RELEASED_M)))
