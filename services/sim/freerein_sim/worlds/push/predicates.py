"""Predicates of the push tasks, on true positions in metres."""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import permutations

import numpy as np

from freerein_sim.worlds.moved_objects import MovedObjects
from freerein_sim.worlds.predicates import Flags, StatePredicate, States
from freerein_sim.worlds.push.criteria import CRITERIA, Criterion, Place, is_close
from freerein_sim.worlds.push.spec import RECIPE
from freerein_sim.worlds.push.things import OBJECT_M, Thing
from freerein_sim.worlds.world import WorldSpec

HIDDEN_X_M = -2.0
"""Things farther back than this are not on show."""

REACHED_M, ALIGNED_M = 0.08, OBJECT_M / 4
"""How far behind a puck's centre, and how far aside, the hand may be to push it."""


def landmarks(spec: WorldSpec, things: Sequence[Thing]) -> tuple[StatePredicate, ...]:
    """Returns the predicates of landmarks."""
    return _objects(spec, things).landmarks()


def skills(spec: WorldSpec, things: Sequence[Thing]) -> tuple[StatePredicate, ...]:
    """Returns `completed/SKILL` of the skills by which the first thing comes close to the second."""
    completed = zip(RECIPE.recipe, (_has_reached, _is_pushed), strict=True)
    objects = _objects(spec, things)
    return tuple(StatePredicate(f"completed/{skill}", partial(holds, objects)) for skill, holds in completed)


def relations(spec: WorldSpec, things: Sequence[Thing]) -> tuple[StatePredicate, ...]:
    """Returns all criteria of all things that they can relate; they hold where these are on show."""
    objects = _objects(spec, things).objects
    places = {thing.name: indices for thing, indices in zip(things, objects, strict=True)}
    return tuple(
        StatePredicate(
            f"relation/{nouns[0].name}-{criterion.name}-{'-and-'.join(each.name for each in nouns[1:])}",
            partial(_is_related, criterion, [places[each.name] for each in nouns]),
            text=f"{nouns[0].noun} {criterion.text} {' and '.join(each.noun for each in nouns[1:])}",
            group=criterion.group and f"{criterion.group}/{nouns[0].name}-{nouns[1].name}",
        )
        for criterion in CRITERIA
        for nouns in related(criterion, things)
    )


def related(criterion: Criterion, things: Sequence[Thing]) -> Iterator[tuple[Thing, ...]]:
    """Yields the things that a criterion can relate; of two others of one thing one order only."""
    for nouns in permutations(things, len(criterion.kinds)):
        fits = all(noun.kind in kinds for noun, kinds in zip(nouns, criterion.kinds, strict=True))
        if fits and [*nouns[1:]] == sorted(nouns[1:], key=things.index):
            yield nouns


def is_behind(hand: Place, first: Place, second: Place) -> Flags:
    """Returns where the hand is behind the first, as it is to push it towards the second; float64 (..., 3) each."""
    ahead = (second - first)[..., :2]
    ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
    offset = (hand - first)[..., :2]
    along = (offset * ahead).sum(axis=-1)
    aside = offset[..., 0] * ahead[..., 1] - offset[..., 1] * ahead[..., 0]
    return np.asarray((along > -REACHED_M) & (along < 0) & (np.abs(aside) < ALIGNED_M))


def is_shown(place: Place) -> Flags:
    """Returns where a thing is on show."""
    return np.asarray(place[..., 0] > HIDDEN_X_M)


def _objects(spec: WorldSpec, things: Sequence[Thing]) -> MovedObjects:
    return MovedObjects(spec.state_names, gripper_axes="xyz", names=[thing.name for thing in things])


def _has_reached(objects: MovedObjects, states: States) -> Flags:
    """The hand has been behind the first thing."""
    first, second = (states[..., indices] for indices in objects.objects[:2])
    return np.logical_or.accumulate(is_behind(states[..., objects.gripper], first, second), axis=1)


def _is_pushed(objects: MovedObjects, states: States) -> Flags:
    """The first two things are close, and were not in the first state."""
    close = is_close(*(states[..., indices] for indices in objects.objects[:2]))  # (N, T)
    return np.asarray(close & ~close[:, :1])


def _is_related(criterion: Criterion, places: Sequence[Sequence[int]], states: States) -> Flags:
    found = [states[..., indices] for indices in places]
    shown = np.logical_and.reduce([is_shown(place) for place in found])
    return np.asarray(shown & criterion.holds(*found))
