"""How an overhand knot is tied by picks and places from above.

The first end is folded back, and the last one laid over it: a loop, whose two ends cross. The last end is laid beside
the first half of the loop, and that half over it; the first end is laid over the other half, into the loop. So along
the rope the crossings are over, under, over and under, over, under, as a pretzel's. Body over end takes the longest:
from above, no end can be put under a strand.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from freerein_sim.worlds.rope.knots import crossings
from freerein_sim.worlds.rope.moves import Move, RopeView, curve_of, lay_down
from freerein_sim.worlds.rope.simulation import Place
from freerein_sim.worlds.rope.spec import LINKS

_FIRST, _LAST = 0, LINKS - 1
_FOLD_M = ((_FIRST, (-0.17, -0.09)), (_FIRST, (-0.04, -0.15)), (_FIRST, (0.10, -0.14)), (_LAST, (0.17, -0.09)))
"""Links, and their places along the straight rope and across it, from its middle."""

_CROSSED_POINT, _BEYOND_M, _SHORT_M, _ACROSS_M = 7, 0.13, 0.03, 0.02
"""The point of the rope that the last end is laid over, how far beyond, and how far before and aside it waits."""

_NEAR_M = 0.05
"""How near to it the last end is laid over at once."""

_END_LINKS, _PULL_M, _PULLS = 6, 0.05, 4
"""Links of an end that is long enough, how far a shorter one is pulled at a time, and how often at most."""

_ASIDE_M = 0.02
"""How far from the loop's side an end is laid down."""

_COVERED_M = 0.035
"""How far the loop's side is laid beyond the end that it covers."""

_END_SHARE, _WAIT_SHARE = 0.4, 0.3
"""Where beside the loop the ends are laid, as shares of its length from the crossing."""

_STRAY_M = 0.003
_STRAIGHT_M, _STRAIGHT_MOVES = 0.05, 12


@dataclass(frozen=True, eq=False)
class Loop:
    """A loop of the rope.

    Attributes:
        crossing: Where the rope crosses itself, x and y.
        into: Unit vector from there into the loop.
        aside: Unit vector at right angles to it, to the side on which the loop's first half is.
        length_m: Twice the distance of its middle from the crossing.
        links: The first link that is wholly inside, and the one after the last.
    """

    crossing: Place
    into: Place
    aside: Place
    length_m: float
    links: tuple[int, int]

    @property
    def halfway(self) -> int:
        """The link in the middle."""
        return sum(self.links) // 2


def knot_moves(rope: RopeView, *, is_mirrored: bool, rng: np.random.Generator) -> Iterator[Move]:
    """Yields the moves that tie the knot; fewer where the rope makes no loop.

    Args:
        rope: The rope.
        is_mirrored: Whether the first end is folded to the left, as seen along the rope.
        rng: Draws how far off the moves are.
    """
    yield from lay_down(rope, curve_of(np.zeros(LINKS), rope), tolerance_m=_STRAIGHT_M, most=_STRAIGHT_MOVES)
    middles = rope.middles
    middle, along = middles.mean(axis=0), _unit(middles[-1] - middles[0])
    across = _left(along) * (-1 if is_mirrored else 1)
    for link, (x, y) in _FOLD_M:
        yield Move(link, middle + x * along + y * across + _STRAY_M * rng.standard_normal(2))
    yield from _cross_over(rope, across)
    yield from _lengthen_ends(rope)
    loop = find_loop(rope)
    if loop is not None:
        yield from _cover_last_end(rope, loop)
        yield from _tuck_first_end(rope, loop)


def find_loop(rope: RopeView) -> Loop | None:
    """Returns the loop that closes first along the rope; None without one."""
    points = rope.points
    found = crossings(points)
    if not len(found.over):
        return None
    first = int(np.argmin(np.minimum(found.over, found.under)))
    begin, end = sorted((float(found.over[first]), float(found.under[first])))
    flat = points[:, :2]
    link = int(begin)
    crossing = flat[link] + (begin - link) * (flat[link + 1] - flat[link])
    inside = flat[link + 1 : int(end) + 1]
    middle = inside.mean(axis=0) - crossing
    into = _unit(middle)
    half = inside[: max(len(inside) // 2, 1)].mean(axis=0)
    aside = _left(into) if (half - crossing) @ _left(into) > 0 else -_left(into)
    return Loop(crossing, into, aside, 2 * float(np.linalg.norm(middle)), (link + 1, int(end)))


def _cross_over(rope: RopeView, across: Place) -> Iterator[Move]:
    """Lays the last end over the first part of the rope, after one or two moves towards it."""
    for _ in range(2):
        points = rope.points[:, :2]
        target, end = points[_CROSSED_POINT], points[-1]
        if np.linalg.norm(target - end) < _NEAR_M:
            break
        yield Move(_LAST, target - _SHORT_M * _unit(target - end) + _ACROSS_M * across)
    points = rope.points[:, :2]
    target = points[_CROSSED_POINT]
    beyond = _left(_unit(points[_CROSSED_POINT + 2] - points[_CROSSED_POINT - 2]))
    beyond = beyond if (target - points[-4]) @ beyond > 0 else -beyond
    yield Move(_LAST, target + _BEYOND_M * beyond)


def _lengthen_ends(rope: RopeView) -> Iterator[Move]:
    """Pulls ends out of the loop until they are long enough to be laid around its sides."""
    for _ in range(_PULLS):
        loop = find_loop(rope)
        if loop is None:
            return
        points, (begin, end) = rope.points[:, :2], loop.links
        lengths = (begin, LINKS - end)
        if min(lengths) >= _END_LINKS:
            return
        link, place = (_FIRST, points[0]) if lengths[0] < lengths[1] else (_LAST, points[-1])
        yield Move(link, place + _PULL_M * _unit(place - loop.crossing))


def _cover_last_end(rope: RopeView, loop: Loop) -> Iterator[Move]:
    """Lays the last end beside the first half of the loop, and that half over it."""
    inside = rope.points[slice(*loop.links), :2] - loop.crossing
    side = float((inside @ loop.aside).max()) + _ASIDE_M
    yield Move(_LAST, loop.crossing + _END_SHARE * loop.length_m * loop.into + side * loop.aside)
    end, middles = rope.points[-1, :2], rope.middles
    half = np.arange(loop.links[0], loop.halfway)
    beside = int(half[np.argmin(np.abs((middles[half] - end) @ loop.into))])
    way = (end - middles[beside]) @ loop.aside + _COVERED_M
    yield Move(beside, middles[beside] + way * loop.aside)


def _tuck_first_end(rope: RopeView, loop: Loop) -> Iterator[Move]:
    """Lays the first end beside the second half of the loop, and from there over it."""
    half = rope.points[loop.halfway : loop.links[1] + 1, :2] - loop.crossing
    side = float((half @ loop.aside).min()) - _ASIDE_M
    yield Move(_FIRST, loop.crossing + _WAIT_SHARE * loop.length_m * loop.into + side * loop.aside)
    yield Move(_FIRST, rope.points[slice(*loop.links), :2].mean(axis=0))


def _unit(vector: Place) -> Place:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))


def _left(vector: Place) -> Place:
    """Returns a vector turned by a quarter to the left."""
    return np.array([-vector[1], vector[0]])
