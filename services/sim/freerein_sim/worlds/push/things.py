"""The things of the push world: pucks and blocks of four colours, and an open tray. Lengths in metres."""

from dataclasses import dataclass
from typing import Literal

from freerein_sim.worlds.colours import RGBA

Kind = Literal["puck", "block", "tray"]

OBJECT_M = 0.05
"""Width of a puck and of a block: the unit of the criteria."""

PUCK_HEIGHT_M = 0.035
TRAY_M, TRAY_HEIGHT_M, TRAY_WALL_M = 0.12, 0.034, 0.004
"""Outer width and height of the tray, and the thickness of its walls and floor."""

_HEIGHT_M: dict[Kind, float] = {"puck": PUCK_HEIGHT_M, "block": OBJECT_M, "tray": TRAY_HEIGHT_M}
_REACH_M: dict[Kind, float] = {"puck": OBJECT_M / 2, "block": OBJECT_M / 2**0.5, "tray": TRAY_M / 2**0.5}


@dataclass(frozen=True)
class Thing:
    """A thing, of which there is at most one in a scene.

    Attributes:
        kind: Its kind.
        colour: Its colour; empty for the tray.
    """

    kind: Kind
    colour: str = ""

    @property
    def name(self) -> str:
        """Its name in true states and predicates, such as `blue-puck`."""
        return f"{self.colour}-{self.kind}" if self.colour else self.kind

    @property
    def noun(self) -> str:
        """Its name in goal texts and captions, such as `a blue puck`."""
        return f"a {self.colour} {self.kind}" if self.colour else f"a {self.kind}"

    @property
    def half_height_m(self) -> float:
        """Height of its centre where it lies on the table."""
        return _HEIGHT_M[self.kind] / 2

    @property
    def reach_m(self) -> float:
        """Greatest horizontal distance of a point of it from its centre."""
        return _REACH_M[self.kind]


COLOURS = tuple(RGBA)
PUCKS = tuple(Thing("puck", colour) for colour in COLOURS)
BLOCKS = tuple(Thing("block", colour) for colour in COLOURS)
TRAY = Thing("tray")
EVERYTHING = (*PUCKS, *BLOCKS, TRAY)
