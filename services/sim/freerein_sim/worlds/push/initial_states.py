"""Initial states of the push world: one sampler for each kind of task, a pure function of a generator."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from freerein_sim.worlds.push.criteria import CLOSE_M, Place
from freerein_sim.worlds.push.scene import HAND_M, LOW_M
from freerein_sim.worlds.push.things import BLOCKS, EVERYTHING, PUCKS, TRAY, TRAY_HEIGHT_M, TRAY_WALL_M, Thing

_AREA_M = np.array([0.13, 0.15])
"""Greatest distance of a thing from the middle of the table, along x and y. The hand comes behind it everywhere."""

_APART_M = CLOSE_M + 0.025
"""Least distance between the pucks of a goal."""

_HAND_ROOM_M = 0.065
"""Least distance between the middle of the hand and what it could touch."""

_PUCKS_ON_SHOW, _BLOCKS_ON_SHOW = (2, 3), (0, 2)
_GAP_M = 0.003
_TRAY_PROBABILITY, _INSIDE_PROBABILITY, _STACK_PROBABILITY, _NEAR_PROBABILITY = 0.7, 0.6, 0.35, 0.3
_LOW_PROBABILITY = 0.6
"""Probability that the hand is as low as it is to push."""

_HIGH_M = (0.115, 0.15)
_NEAR_M = 0.02
_OFF_CENTRE_M = 0.012
"""How far, along an axis, a thing is from the middle of the one that it lies in or on."""

_TRIES = 40

PARKED_M = np.array([(-3.0, 0.2 * i, 1.0) for i in range(len(EVERYTHING))])
"""Where things float that are not on show and no camera sees them, in the order of `EVERYTHING`: float64 (9, 3)."""


@dataclass(frozen=True, eq=False)
class InitialState:
    """State before the first action.

    Attributes:
        hand: Middle between the fingertips, float64 (3,).
        places: Centres of the things of the scene, float64 (N, 3), in metres.
        yaws_rad: How far each is turned, float64 (N,).
    """

    hand: Place
    places: Place
    yaws_rad: Place


InitialStateSampler = Callable[[np.random.Generator], InitialState]


def pair(rng: np.random.Generator) -> InitialState:
    """Returns two pucks, anywhere but not close, and the hand as low as it is to push, anywhere beside them."""
    while True:
        places = {thing: _on_table(rng, thing) for thing in PUCKS[:2]}
        first, second = places.values()
        hand = _low_hand(rng, places)
        if hand is not None and np.linalg.norm(first - second) >= _APART_M:
            return InitialState(hand, np.stack([first, second]), rng.uniform(-np.pi, np.pi, size=2))


def scatter(rng: np.random.Generator) -> InitialState:
    """Returns two or three pucks, up to two blocks and often the tray, at places that show all criteria.

    One thing may lie in the tray and one on another; some begin beside another. The hand is low or above everything.
    """
    while (start := _try_scatter(rng)) is None:
        pass
    return start


def _try_scatter(rng: np.random.Generator) -> InitialState | None:
    """Draws a scene; None where there was no room for it."""
    shown = [*_some(rng, PUCKS, *_PUCKS_ON_SHOW), *_some(rng, BLOCKS, *_BLOCKS_ON_SHOW)]
    waiting = [shown[i] for i in rng.permutation(len(shown))]
    has_tray = rng.random() < _TRAY_PROBABILITY
    inside = waiting.pop() if has_tray and rng.random() < _INSIDE_PROBABILITY else None
    upper = waiting.pop() if len(waiting) > 1 and rng.random() < _STACK_PROBABILITY else None
    places: dict[Thing, Place] = {}
    for thing in [TRAY, *waiting] if has_tray else waiting:
        place = _free_place(rng, thing, places)
        if place is None:
            return None
        places[thing] = place
    if inside:
        places[inside] = _put(rng, inside, places[TRAY], TRAY_WALL_M - TRAY_HEIGHT_M / 2)
    if upper:
        lower = waiting[0]
        on_top = _put(rng, upper, places[lower], lower.half_height_m)
        if not _is_free(upper, on_top, {each: at for each, at in places.items() if each not in (lower, inside)}):
            return None
        places[upper] = on_top
    hand = _low_hand(rng, places) if rng.random() < _LOW_PROBABILITY else None
    if hand is None:
        hand = np.array([*rng.uniform(-HAND_M, HAND_M), rng.uniform(*_HIGH_M)])
    everything = np.stack([places.get(thing, parked) for thing, parked in zip(EVERYTHING, PARKED_M, strict=True)])
    return InitialState(hand, everything, rng.uniform(-np.pi / 4, np.pi / 4, size=len(EVERYTHING)))


def _some(rng: np.random.Generator, things: Sequence[Thing], fewest: int, most: int) -> list[Thing]:
    return [things[i] for i in rng.permutation(len(things))[: rng.integers(fewest, most, endpoint=True)]]


def _put(rng: np.random.Generator, thing: Thing, other: Place, surface_m: float) -> Place:
    """Draws where a thing lies in or on another one, whose surface is that much higher than its centre."""
    off_m = rng.uniform(-_OFF_CENTRE_M, _OFF_CENTRE_M, size=2)
    return np.add(other, (*off_m, surface_m + thing.half_height_m))


def _on_table(rng: np.random.Generator, thing: Thing) -> Place:
    return np.array([*rng.uniform(-_AREA_M, _AREA_M), thing.half_height_m])


def _free_place(rng: np.random.Generator, thing: Thing, taken: dict[Thing, Place]) -> Place | None:
    """Draws a place on the table beside all others, sometimes close to one of them; None where none was found."""
    others, is_near = list(taken), bool(taken) and rng.random() < _NEAR_PROBABILITY
    for _ in range(_TRIES):
        place = _on_table(rng, thing)
        if is_near:
            other = others[rng.integers(len(others))]
            angle = rng.uniform(-np.pi, np.pi)
            distance_m = other.reach_m + thing.reach_m + _GAP_M + rng.uniform(0, _NEAR_M)
            place[:2] = taken[other][:2] + distance_m * np.array([np.cos(angle), np.sin(angle)])
        if (np.abs(place[:2]) <= _AREA_M).all() and _is_free(thing, place, taken):
            return place
    return None


def _is_free(thing: Thing, place: Place, taken: dict[Thing, Place]) -> bool:
    """Returns whether a thing at a place is beside all others."""
    gaps_m = [np.hypot(*(place - at)[:2]) - other.reach_m - thing.reach_m for other, at in taken.items()]
    return min(gaps_m, default=np.inf) >= _GAP_M


def _low_hand(rng: np.random.Generator, places: dict[Thing, Place]) -> Place | None:
    """Draws where the hand is low and touches nothing; None where no such place was found."""
    at, room_m = np.stack([*places.values()]), np.array([thing.reach_m + _HAND_ROOM_M for thing in places])
    for _ in range(_TRIES):
        hand = np.array([*rng.uniform(-HAND_M, HAND_M), LOW_M])
        if (np.linalg.norm((hand - at)[:, :2], axis=1) > room_m).all():
            return hand
    return None
