"""The maps of the world: A as ViZDoom's wheel has it, A with two sets of other textures, and B.

All textures are Freedoom's. No two sets share one. Lengths are in map units; a room is 160 wide, a corridor 64.
"""

import hashlib
import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from freerein.errors import FailedPrecondition
from freerein_sim.worlds.doom import textmap, wad
from freerein_sim.worlds.doom.grid_map import GridMap
from freerein_sim.worlds.doom.textmap import Point

INSTALL = "pip install --no-deps -r assets-doom.txt"
MAP_NAME = "MAP01"
GAME = Path("freedoom2.wad")

_MAP_A = Path("scenarios/my_way_home.wad")
_SHA256 = {
    _MAP_A: "18e98ff4c9186808eb00696b799cfe88a79e7486429c1692aafbed8ef359c0b1",
    GAME: "a8772e088847032510d97ba2312406a6998f21cbab44d4ff10696faa9c0ecd4b",
    Path("vizdoom.pk3"): "24381138aede0ab03a4266f8fdd0225a1819658f004d37c9dc349e006b74f34e",
}
"""Files of the wheel that decide what is seen, and what happens."""

_SPOTS_A = {
    10: (240, -176),
    11: (464, -176),
    12: (470, -322),
    13: (467, -467),
    14: (460, -596),
    15: (544, -672),
    16: (575, -172),
    17: (687, -173),
    18: (687, -62),
    19: (464, -60),
    20: (460, 56),
    21: (572, 55),
    22: (694, 58),
    23: (871, 55),
    24: (1043, 60),
    25: (1040, -62),
    26: (1039, -170),
}
"""Where my_way_home.wad begins an episode, rounded: in rooms and in corridors."""

_TEXTURES_A = (
    "BIGBRIK1",  # corridors
    "BIGDOOR2",
    "CEIL4_2",
    "COMP01",
    "CRATE2",
    "FLOOR1_6",
    "SFALL2",
    "SILVER2",
    "TLITE6_1",
    "FLAT1_1",  # floors and ceilings
)
_V1 = ("BRICK12", "METAL1", "GRAY7", "TEKWALL4", "WOOD6", "ROCK5", "PIPE1", "MARBLE1", "PANBOOK", "RROCK16")
_V2 = ("STONE2", "SPACEW4", "TANROCK2", "SK_LEFT", "STARG3", "WOOD1", "PLANET1", "SUPPORT2", "GRAYVINE", "RROCK11")

GRID_B = GridMap(
    rows=(
        "aaaaa...bbbbb.......ccccc..",
        "aaaaa...bbbbb.......ccccc..",
        "aaaaa+++bbbbb+++++++ccccc..",
        "aaaaa+++bbbbb+++++++ccccc..",
        "aaaaa...bbbbb.......ccccc..",
        ".++..................++....",
        ".++..................++....",
        "ddddd...eeeee........++....",
        "ddddd...eeeee.......fffff..",
        "ddddd+++eeeee+++++++fffff..",
        "ddddd+++eeeee+++++++fffff..",
        "ddddd...eeeee.......fffff..",
        "..........++........fffff..",
        "..........++...............",
        "..........++++++...........",
        "..........++++++...........",
        "..............ggggg...hhhhh",
        "..............ggggg...hhhhh",
        "..............ggggg+++hhhhh",
        "..............ggggg+++hhhhh",
        "..............ggggg...hhhhh",
    ),
    cell_units=32,
    walls={
        "+": "BSTONE1",
        "a": "ICKWALL1",
        "b": "STARTAN2",
        "c": "TEKWALL1",
        "d": "ZIMMER8",
        "e": "SLADWALL",
        "f": "ROCK1",
        "g": "SILVER3",
        "h": "CRATE1",
    },
    floor="AQF052",
    ceiling="CEIL3_5",
    rooms="abcdefgh",
)


@dataclass(frozen=True, eq=False)
class DoomMap:
    """A map.

    Attributes:
        spots: Places where episodes begin, by number.
        routes: First and last spot of each path.
        textures: What replaces `_TEXTURES_A`, in map A with other textures.
        grid: The text grid, of a map that is not A.
    """

    spots: Mapping[int, Point]
    routes: Mapping[str, tuple[int, int]]
    textures: tuple[str, ...] = ()
    grid: GridMap | None = field(default=None, repr=False)

    def ends(self, path: str) -> tuple[Point, Point]:
        """Returns the first and the last place of a path."""
        first, last = self.routes[path]
        return self.spots[first], self.spots[last]

    def wad(self) -> bytes:
        """Returns the map as a WAD file. Raises FailedPrecondition where ViZDoom's wheel is missing, or another."""
        if self.grid:
            return _write(self.grid.text())
        own = _read(_MAP_A)
        return _write(textmap.replace_textures(_text_of(own), self._names()), own) if self.textures else own

    def text(self) -> str:
        """Returns the map as UDMF. Raises FailedPrecondition as `wad`."""
        return _text_of(self.wad())

    def _names(self) -> Mapping[str, str]:
        return dict(zip(_TEXTURES_A, self.textures, strict=True))


def _paths(*routes: tuple[int, int]) -> Mapping[str, tuple[int, int]]:
    return {f"path-{number}": route for number, route in enumerate(routes, 1)}


_ROUTES_A = _paths((10, 26), (26, 14), (15, 22), (24, 13), (24, 10))
_ROUTES_V1 = _paths((26, 10), (13, 24), (22, 15), (14, 26), (10, 24))
_ROUTES_B = _paths((10, 17), (17, 12), (12, 16), (17, 11), (11, 16))

A = DoomMap(_SPOTS_A, _ROUTES_A)
A_V1 = DoomMap(_SPOTS_A, _ROUTES_V1, textures=_V1)
A_V2 = DoomMap(_SPOTS_A, _ROUTES_A, textures=_V2)
B = DoomMap(GRID_B.spots(), _ROUTES_B, grid=GRID_B)


@lru_cache(maxsize=1)
def wheel() -> Path:
    """Returns the folder of ViZDoom's wheel, which is not imported.

    Raises:
        FailedPrecondition: It is not installed, or has other files than those of the release that is named.
    """
    found = importlib.util.find_spec("vizdoom")
    if found is None or found.origin is None:
        raise FailedPrecondition("This world runs the wheel vizdoom, which is not installed.", hint=INSTALL)
    folder = Path(found.origin).parent
    for name, expected in _SHA256.items():
        if hashlib.sha256((folder / name).read_bytes()).hexdigest() != expected:
            raise FailedPrecondition(
                f"This world is of vizdoom 1.3.2; its file {name} is another in what is installed.", hint=INSTALL
            )
    return folder


def wheel_hash() -> str:
    """Returns a hash of what the world reads of the wheel."""
    return hashlib.sha256(" ".join(_SHA256.values()).encode()).hexdigest()


def _read(name: Path) -> bytes:
    return (wheel() / name).read_bytes()


def _text_of(file: bytes) -> str:
    return dict(wad.read(file))["TEXTMAP"].decode()


def _write(text: str, like: bytes = b"") -> bytes:
    """Returns a WAD of a map, with the scripts of another; the engine computes its nodes when it loads it."""
    scripts = [(name, lump) for name, lump in wad.read(like) if name == "BEHAVIOR"] if like else []
    return wad.write([(MAP_NAME, b""), ("TEXTMAP", text.encode()), *scripts, ("ENDMAP", b"")])
