"""Scenes of `push.scatter` in which table 4.1's nine criteria occur, and what is true in them.

The grounding model knows colours, and neither pucks nor trays: things are named by colour, `a blue object`, and the
tray is `a cyan object`. A colour that two things of a scene share names neither, and is not asked for.
"""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import combinations, permutations
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from experiments.robustness.draw import Drawn
from experiments.robustness.worlds import open_world
from freerein.criteria import CRITERIA as NAMED
from freerein_sim.worlds.generators import generator
from freerein_sim.worlds.push import criteria
from freerein_sim.worlds.push.things import COLOURS, EVERYTHING
from freerein_sim.worlds.random_policy import SmoothRandomPolicy
from freerein_sim.worlds.tasks import tasks

CAMERAS = ("front", "left")
"""The front camera looks down at 37 degrees, and is the tilted one, too; the left one is the side view."""

TRAY_COLOUR = "cyan"
NOUNS = (*COLOURS, TRAY_COLOUR)
PHRASES = tuple(f"a {colour} object" for colour in NOUNS)

_SIZE, _STEPS = 64, 4
_HIDDEN_X_M = -2.0

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class PuckScenes:
    """First and last frames of short random rollouts, of two cameras; a trajectory has two."""

    count: int
    seed: int
    task: ClassVar[str] = "push.scatter"

    def draw(self) -> Drawn:
        """Draws the scenes."""
        frames: dict[str, list[npt.NDArray[np.uint8]]] = {camera: [] for camera in CAMERAS}
        states = []
        with closing(open_world(self.task)) as world:
            for index in range(self.count):
                rng = generator(np.random.SeedSequence(self.seed, spawn_key=(index,)))
                world.reset(rng)
                policy = SmoothRandomPolicy(world.spec.action, rng)
                for steps in (0, _STEPS):
                    for _ in range(steps):
                        world.step(policy.act().action)
                    states.append(np.array(world.truth().state, np.float64))
                    for camera, seen in frames.items():
                        seen.append(world.render(camera, height=_SIZE, width=_SIZE).copy())
        lengths = np.full(self.count, 2)
        return Drawn(
            {"lengths": lengths, **{name: np.stack(each) for name, each in frames.items()}},
            {"states": np.stack(states)},
        )


@dataclass(frozen=True, eq=False)
class Asked:
    """A goal of two or three nouns.

    Attributes:
        criterion: Name of the criterion.
        nouns: Numbers of the nouns among `NOUNS`.
        holds: Whether it holds, bool (M,).
        counts: Where that can be asked, bool (M,): each noun names one thing, of a kind that the criterion relates.
            Of a side or depth, one of the two must hold; of what is in between, or is not, each of the others must be
            to a side of the first.
    """

    criterion: str
    nouns: tuple[int, ...]
    holds: Flags
    counts: Flags


def asked(states: npt.NDArray[np.float64]) -> Iterator[Asked]:
    """Yields all goals of scenes, whose true states are float64 (M, S)."""
    places, kinds = _named(states)
    for name in NAMED:
        (criterion,) = (each for each in criteria.CRITERIA if each.name.replace("-", "_") == name)
        for nouns in _tuples(len(criterion.kinds)):
            at = [places[:, noun] for noun in nouns]
            holds = criterion.holds(*at)
            fits = np.ones(len(states), np.bool_)
            for noun, related in zip(nouns, criterion.kinds, strict=True):
                fits &= np.isin(kinds[:, noun], related)
            fits &= _is_plain(criterion, at)
            yield Asked(name, nouns, holds & fits, fits)


def _is_plain(criterion: criteria.Criterion, at: Sequence[criteria.Place]) -> Flags:
    """Returns where things are beside each other, or behind, by half a width; everywhere where that is not asked."""
    first, *others = at
    match criterion.group or criterion.name:
        case "side" | "in-between":
            apart = [criteria.is_left(first, each) | criteria.is_left(each, first) for each in others]
        case "depth":
            apart = [criteria.is_in_front(first, each) | criteria.is_in_front(each, first) for each in others]
        case _:
            apart = [np.ones(len(first), np.bool_)]
    return np.asarray(np.all(apart, axis=0))


def _tuples(size: int) -> list[tuple[int, ...]]:
    """Returns the nouns that a goal may relate; the last two of three in one order."""
    numbers = range(len(NOUNS))
    if size == 2:
        return list(permutations(numbers, 2))
    return [(first, *others) for first in numbers for others in combinations([i for i in numbers if i != first], 2)]


def _named(states: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.str_]]:
    """Returns place (M, nouns, 3) and kind (M, nouns) of what each noun names; an empty kind where that is not one."""
    names = tasks()[PuckScenes.task].spec.state_names
    places = np.zeros((len(states), len(NOUNS), 3))
    kinds = np.full((len(states), len(NOUNS)), "", "<U5")
    counts = np.zeros(kinds.shape, np.int64)
    for thing in EVERYTHING:
        noun = NOUNS.index(thing.colour or TRAY_COLOUR)
        at = states[:, [names.index(f"{thing.name}.{axis}") for axis in "xyz"]]
        is_shown = at[:, 0] > _HIDDEN_X_M
        places[is_shown, noun], kinds[is_shown, noun] = at[is_shown], thing.kind
        counts[:, noun] += is_shown
    return places, np.where(counts == 1, kinds, "")
