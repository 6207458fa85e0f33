"""Predicates of the bins task, on true positions in metres."""

import numpy as np

from freerein_sim.worlds.bins.layout import COMPARTMENT_HALF_M, FLOOR_M, GROCERIES, Grocery, Place
from freerein_sim.worlds.bins.spec import SPEC
from freerein_sim.worlds.moved_objects import MovedObjects
from freerein_sim.worlds.predicates import Flags, States

_LIFTED_M = 0.03
_RESTING_M = 0.01
_RELEASED_M = 0.012
_AWAY_M = 0.12


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


def _is_completed(index: int, states: States) -> Flags:
    """The grocery lay elsewhere in the first state, and now lies in its compartment, released."""
    at = states[..., _OBJECTS.objects[index]]
    opening_m = states[..., SPEC.state_names.index("gripper.opening")]
    lies = is_placed(GROCERIES[index], at, gripper=states[..., _OBJECTS.gripper], opening_m=opening_m)  # (N, T)
    return np.asarray(lies & ~is_in_compartment(GROCERIES[index], at[:, :1]))


_NAMES = tuple(each.name for each in GROCERIES)
_OBJECTS = MovedObjects(SPEC.state_names, gripper_axes="xyz", names=_NAMES, lifted_m=_LIFTED_M)
PREDICATES = _OBJECTS.predicates({f"move-{name}": index for index, name in enumerate(_NAMES)}, _is_completed)
"""Predicates of landmarks and of each skill `move-GROCERY`."""
