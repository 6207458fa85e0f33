"""Shared by the experts of the rope world: moves, and a rope laid down in a given curve move by move."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.rope.knots import Points
from freerein_sim.worlds.rope.simulation import Place, RopeWorld
from freerein_sim.worlds.rope.spec import LINK_M

Curve = npt.NDArray[np.float64]
"""float64 (25, 2): places of the middles of the links, x and y in metres."""


@dataclass(frozen=True, eq=False)
class Move:
    """Brings the middle of a link towards a place, as far as one action does."""

    link: int
    place: Place


@dataclass(frozen=True, eq=False)
class RopeView:
    """The rope of a world, numbered from either of its ends.

    Attributes:
        world: The world.
        is_reversed: Whether its last link counts as the first.
    """

    world: RopeWorld
    is_reversed: bool = False

    @property
    def points(self) -> Points:
        """Ends of the links: float64 (26, 3)."""
        return self.world.points[::-1] if self.is_reversed else self.world.points

    @property
    def middles(self) -> Curve:
        """Middles of the links."""
        points = self.points[:, :2]
        return np.asarray((points[1:] + points[:-1]) / 2)


def lay_down(rope: RopeView, curve: Curve, *, tolerance_m: float, most: int) -> Iterator[Move]:
    """Yields moves of the link that is farthest from its place, until none is farther than the tolerance."""
    for _ in range(most):
        apart = np.linalg.norm(rope.middles - curve, axis=1)
        if apart.max() <= tolerance_m:
            return
        link = int(apart.argmax())
        yield Move(link, curve[link])


def curve_of(headings: npt.NDArray[np.float64], rope: RopeView) -> Curve:
    """Returns the curve of links with these headings, turned and moved as close to the rope as it gets."""
    steps = LINK_M * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    curve, now = np.cumsum(steps, axis=0) - steps / 2, rope.middles
    curve -= curve.mean(axis=0)
    about = now - now.mean(axis=0)
    cosine, sine = (curve * about).sum(), (curve[:, 0] * about[:, 1] - curve[:, 1] * about[:, 0]).sum()
    turn = np.array([[cosine, sine], [-sine, cosine]]) / np.hypot(cosine, sine)
    return np.asarray(curve @ turn)
