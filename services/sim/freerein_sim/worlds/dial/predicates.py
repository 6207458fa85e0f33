"""Predicates of the dial task, on true states in metres."""

from functools import partial

import numpy as np

from freerein_sim.worlds.dial import keypad
from freerein_sim.worlds.dial.spec import SPEC
from freerein_sim.worlds.predicates import Flags, StatePredicate, States


def is_pressed(digit: int, fingertip: States, depth: States) -> Flags:
    """Returns whether the fingertip holds a key down.

    Args:
        digit: The key's digit.
        fingertip: float64 (..., 2 or more): x, y of the fingertip.
        depth: float64 (...): how far the key is pushed down.
    """
    offset = np.abs(fingertip[..., :2] - keypad.CENTRES_M[digit])
    over = (offset <= keypad.KEY_HALF_M[:2]).all(axis=-1)
    return np.asarray(over & (depth >= keypad.PRESSED_M))


def _is_completed(digit: int, states: States) -> Flags:
    """The key was not pressed at some timestep, and was at the next."""
    tip = [SPEC.state_names.index(f"fingertip.{axis}") for axis in "xy"]
    depth = SPEC.state_names.index(f"key-{digit}.depth")
    pressed = is_pressed(digit, states[..., tip], states[..., depth])  # (N, T)
    begins = np.zeros_like(pressed)
    begins[:, 1:] = pressed[:, 1:] & ~pressed[:, :-1]
    return np.asarray(np.maximum.accumulate(begins, axis=1))


PREDICATES = tuple(StatePredicate(f"completed/press-{digit}", partial(_is_completed, digit)) for digit in keypad.DIGITS)
