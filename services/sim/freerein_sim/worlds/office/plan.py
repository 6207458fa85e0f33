"""Floor plans: rooms as text, with what is derived from it: walls, what hangs on them, and what the robot runs into.

A character is a square of half a metre, and each letter a room with a floor and walls of its own. A wall is between two
rooms, and around all, but for doorways: between neighbouring squares that are both written in capitals. Rows go from
north to south; x points east, y north, and the south-western corner is the origin.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import groupby

import numpy as np

from freerein_sim.worlds.office import rectangles
from freerein_sim.worlds.office.furniture import Box, Piece
from freerein_sim.worlds.office.rectangles import Rectangles
from freerein_sim.worlds.office.spec import ROBOT_RADIUS_M
from freerein_sim.worlds.walkable_grid import WalkableGrid

SQUARE_M, WALL_M, CEILING_M = 0.5, 0.05, 2.5
CELL_M, AHEAD_M = 0.1, 0.4
"""Cell of the grid on which ways are planned, and how far ahead on its way a walker looks."""

_CLEAR_M, _ROOMY_M = ROBOT_RADIUS_M + 0.08, 0.6
_OUTSIDE = "."
_SIDES = {"north": (-1, 0), "south": (1, 0), "west": (0, -1), "east": (0, 1)}
_HUNG_M, _HUNG_EVERY_M = 0.02, 1.4
_HUNG_OUTSIDE = ("window", "window", "poster")
_HUNG_INSIDE = ("poster", "door", "poster", "whiteboard")
_HUNG = {"window": (1.0, 0.8, 2.0), "poster": (0.7, 0.7, 1.6), "door": (0.8, 0.0, 2.0), "whiteboard": (1.1, 0.8, 1.7)}
"""Width, lower and upper edge of what hangs on walls."""

Point = tuple[float, float]
"""x and y in metres."""

GoalPose = tuple[float, float, float]
"""x and y in metres, heading in degrees."""


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """A floor of the building.

    Attributes:
        seed: Draws textures, and what hangs on the walls.
        rows: The rooms.
        furniture: Where furniture stands.
        paths: By skill, the places that a walk leads through, from its beginning to its end.
        goals: By skill, a pose to be reached.
    """

    seed: int
    rows: Sequence[str]
    furniture: Sequence[Piece]
    paths: Mapping[str, Sequence[Point]]
    goals: Mapping[str, GoalPose]

    @property
    def size_m(self) -> Point:
        """Extent along x and y."""
        return len(self.rows[0]) * SQUARE_M, len(self.rows) * SQUARE_M

    @property
    def rooms(self) -> list[str]:
        """Letters of the rooms, sorted."""
        return sorted({square.lower() for row in self.rows for square in row})

    @cached_property
    def walls(self) -> Rectangles:
        """Rectangles of the walls."""
        return np.array([wall.rectangle for wall in self._walls()])

    @cached_property
    def obstacles(self) -> Rectangles:
        """Rectangles that the robot cannot enter: walls and furniture."""
        return np.concatenate([self.walls, np.array([piece.rectangle() for piece in self.furniture])])

    @cached_property
    def grid(self) -> WalkableGrid:
        """Where the robot can drive."""
        clearance = partial(rectangles.distance, self.obstacles)
        low, high = np.zeros(2), np.array(self.size_m)
        return WalkableGrid(clearance, low, high, cell=CELL_M, clear=_CLEAR_M, roomy=_ROOMY_M)

    def boxes(self) -> Iterator[Box]:
        """Yields all that is drawn: floors, ceiling, walls, what hangs on them, and furniture."""
        rng = np.random.default_rng(self.seed)
        yield from self._floors_and_ceiling()
        posters = 0
        for wall in self._walls():
            yield wall.box(0, CEILING_M, f"wall-{wall.room}")
            for hung in wall.draw_hung(rng):
                posters += hung.texture == "poster"
                texture = f"poster-{posters}" if hung.texture == "poster" else hung.texture
                yield Box(hung.low, hung.high, texture)
        for piece in self.furniture:
            yield from piece.boxes()

    def _floors_and_ceiling(self) -> Iterator[Box]:
        """Yields the floor of each room, row by row, and one ceiling."""
        width, depth = self.size_m
        yield Box((0, 0, CEILING_M), (width, depth, CEILING_M + WALL_M), "ceiling")
        for number, row in enumerate(self.rows):
            south = depth - (number + 1) * SQUARE_M
            for room, squares in groupby(enumerate(row.lower()), key=lambda square: square[1]):
                columns = [column for column, _ in squares]
                west, east = columns[0] * SQUARE_M, (columns[-1] + 1) * SQUARE_M
                yield Box((west, south, -WALL_M), (east, south + SQUARE_M, 0), f"floor-{room}")

    def _walls(self) -> Iterator["_Wall"]:
        """Yields the walls of each room, inside it, each as long as it is straight."""
        for side in _SIDES:
            for lane in range(len(self.rows) if side in ("north", "south") else len(self.rows[0])):
                for (room, beyond), squares in groupby(self._lane(side, lane), key=lambda square: square[1:]):
                    places = [place for place, *_ in squares]
                    if room not in (_OUTSIDE, beyond):
                        yield self._wall(side, lane, places, room, is_outer=beyond == _OUTSIDE)

    def _lane(self, side: str, lane: int) -> Iterator[tuple[int, str, str]]:
        """Yields the squares of a row or column: where, the room, and that beyond the side, in doorways itself."""
        down, across = _SIDES[side]
        for place in range(len(self.rows[0]) if down else len(self.rows)):
            row, column = (lane, place) if down else (place, lane)
            here, beyond = self._square(row, column), self._square(row + down, column + across)
            is_open = here.isupper() and beyond.isupper()
            yield place, here.lower(), here.lower() if is_open else beyond.lower()

    def _square(self, row: int, column: int) -> str:
        inside = 0 <= row < len(self.rows) and 0 <= column < len(self.rows[0])
        return self.rows[row][column] if inside else _OUTSIDE

    def _wall(self, side: str, lane: int, places: Sequence[int], room: str, *, is_outer: bool) -> "_Wall":
        begin, end = places[0] * SQUARE_M, (places[-1] + 1) * SQUARE_M
        near = lane * SQUARE_M
        if side in ("west", "east"):
            x = near if side == "west" else near + SQUARE_M - WALL_M
            depth = self.size_m[1]
            return _Wall(room, side, (x, depth - end, x + WALL_M, depth - begin), is_outer)
        y = self.size_m[1] - (near + WALL_M if side == "north" else near + SQUARE_M)
        return _Wall(room, side, (begin, y, end, y + WALL_M), is_outer)


@dataclass(frozen=True)
class _Wall:
    """A wall of a room: its side, its rectangle, and whether it is an outer wall."""

    room: str
    side: str
    rectangle: tuple[float, float, float, float]
    is_outer: bool

    def box(self, bottom: float, top: float, texture: str) -> Box:
        low_x, low_y, high_x, high_y = self.rectangle
        return Box((low_x, low_y, bottom), (high_x, high_y, top), texture)

    def draw_hung(self, rng: np.random.Generator) -> Iterator[Box]:
        """Yields what hangs on it, drawn anew about every `_HUNG_EVERY_M`."""
        low_x, low_y, high_x, high_y = self.rectangle
        along = 0 if self.side in ("north", "south") else 1
        length = (high_x - low_x, high_y - low_y)[along]
        count = int(length / _HUNG_EVERY_M)
        for number in range(count):
            name = str(rng.choice(_HUNG_OUTSIDE if self.is_outer else _HUNG_INSIDE))
            width, bottom, top = _HUNG[name]
            middle = (low_x, low_y)[along] + (number + 0.5 + rng.uniform(-0.08, 0.08)) * length / count
            low, high = [low_x - _HUNG_M, low_y - _HUNG_M, bottom], [high_x + _HUNG_M, high_y + _HUNG_M, top]
            low[along], high[along] = middle - width / 2, middle + width / 2
            yield Box((low[0], low[1], low[2]), (high[0], high[1], high[2]), name)
