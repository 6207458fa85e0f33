"""Draws a map from a text grid: `.` is solid, any other character a zone with floor, ceiling and walls of its own.

Rows go from north to south. The first row's north-western corner is the origin.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from freerein_sim.worlds.doom.textmap import Point, write_block

SOLID = "."
_CEILING_UNITS, _LIGHT = 128, 192
_FIRST_SPOT = 10
_PLAYER_START_TYPE = 1
_SKILLS = range(1, 6)
_STEPS = {"north": (-1, 0), "south": (1, 0), "west": (0, -1), "east": (0, 1)}


@dataclass(frozen=True)
class GridMap:
    """A map of cells.

    Attributes:
        rows: Rows of one length.
        cell_units: Width of a cell.
        walls: Texture of each zone's walls.
        floor: Texture of all floors.
        ceiling: Texture of all ceilings.
        rooms: Zones in whose middle episodes may begin, numbered from 10 on; the player's own start is the first.
    """

    rows: Sequence[str]
    cell_units: int
    walls: Mapping[str, str]
    floor: str
    ceiling: str
    rooms: str

    def spots(self) -> dict[int, Point]:
        """Returns the middle of each room, by its number."""
        return {_FIRST_SPOT + number: self._middle(room) for number, room in enumerate(self.rooms)}

    def text(self) -> str:
        """Returns the map as UDMF."""
        zones, edges = sorted(self.walls), list(self._edges())
        corners = sorted({corner for edge in edges for corner in (edge.begin, edge.end)})
        x, y = self.spots()[_FIRST_SPOT]
        player = {"type": _PLAYER_START_TYPE, "angle": 0, "single": True} | {f"skill{each}": True for each in _SKILLS}
        blocks = ['namespace = "zdoom";\n', write_block("thing", x=float(x), y=float(y), **player)]
        blocks += [write_block("vertex", x=float(x), y=float(y)) for x, y in corners]
        sides: list[str] = []
        for edge in edges:
            ends = {"v1": corners.index(edge.begin), "v2": corners.index(edge.end), "sidefront": len(sides)}
            front = {"sector": zones.index(edge.zone)}
            if edge.beyond == SOLID:
                blocks.append(write_block("linedef", **ends, blocking=True))
                sides.append(write_block("sidedef", **front, texturemiddle=self.walls[edge.zone]))
            else:
                blocks.append(write_block("linedef", **ends, sideback=len(sides) + 1, twosided=True))
                sides += [write_block("sidedef", sector=zones.index(zone)) for zone in (edge.zone, edge.beyond)]
        room = {"heightfloor": 0, "heightceiling": _CEILING_UNITS, "lightlevel": _LIGHT}
        sector = write_block("sector", **room, texturefloor=self.floor, textureceiling=self.ceiling)
        return "".join([*blocks, *sides, *[sector] * len(zones)])

    def _middle(self, zone: str) -> Point:
        cells = [(row, column) for row, line in enumerate(self.rows) for column, at in enumerate(line) if at == zone]
        row, column = (sum(numbers) / len(cells) + 0.5 for numbers in zip(*cells, strict=True))
        return round(column * self.cell_units), round(-row * self.cell_units)

    def _edges(self) -> Iterator["_Edge"]:
        """Yields the lines between zones and around them, each as long as it is straight and between the same two."""
        for side in _STEPS:
            for lane in range(len(self.rows) if side in ("north", "south") else len(self.rows[0])):
                for (zone, beyond), cells in groupby(self._lane(side, lane), key=lambda cell: cell[1:]):
                    places = [place for place, *_ in cells]
                    if zone in (SOLID, beyond) or (beyond != SOLID and side in ("north", "west")):
                        continue  # no line, or the one that the neighbour yields
                    yield _Edge(*self._corners(side, lane, places[0], places[-1] + 1), zone, beyond)

    def _lane(self, side: str, lane: int) -> Iterator[tuple[int, str, str]]:
        """Yields the cells of a row, or of a column: where, the zone, and the one beyond that side."""
        down, across = _STEPS[side]
        for place in range(len(self.rows[0]) if down else len(self.rows)):
            row, column = (lane, place) if down else (place, lane)
            yield place, self._zone(row, column), self._zone(row + down, column + across)

    def _zone(self, row: int, column: int) -> str:
        inside = 0 <= row < len(self.rows) and 0 <= column < len(self.rows[0])
        return self.rows[row][column] if inside else SOLID

    def _corners(self, side: str, lane: int, begin: int, end: int) -> tuple[Point, Point]:
        """Returns the ends of the line at a side of a run of cells; they are to its right, as in Doom."""
        far = lane + (side in ("south", "east"))
        if side in ("north", "south"):
            west, east = ((place * self.cell_units, -far * self.cell_units) for place in (begin, end))
            return (west, east) if side == "north" else (east, west)
        north, south = ((far * self.cell_units, -place * self.cell_units) for place in (begin, end))
        return (north, south) if side == "east" else (south, north)


@dataclass(frozen=True)
class _Edge:
    """A line between two corners, its zone, and what is beyond."""

    begin: Point
    end: Point
    zone: str
    beyond: str
