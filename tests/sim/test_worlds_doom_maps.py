"""Maps of the world `doom`: what is computed without ViZDoom."""

import sys
from pathlib import Path

import numpy as np
import pytest

from freerein.errors import FailedPrecondition
from freerein_sim.worlds.doom import TASKS, maps, textmap, wad
from freerein_sim.worlds.doom.floor import CELL_UNITS, CLEAR_UNITS, floor_between
from freerein_sim.worlds.doom.grid_map import GridMap
from freerein_sim.worlds.predicates import States

TWO_ROOMS = GridMap(
    rows=("aa.bb", "aa+bb", "..+.."),
    cell_units=32,
    walls={"a": "STONE2", "b": "WOOD1", "+": "METAL1"},
    floor="FLAT1_1",
    ceiling="FLAT1_1",
    rooms="ab",
)
PREDICATES = {each.name: each for each in TASKS[0].predicates}


def states(*poses: tuple[float, float, float]) -> States:
    return np.array([poses])


def test_a_wad_file_has_the_lumps_that_were_written_in_their_order() -> None:
    lumps = [("MAP01", b""), ("TEXTMAP", b"thing"), ("ENDMAP", b"")]
    file = wad.write(lumps)

    assert wad.read(file) == lumps
    assert file[:12] == b"PWAD\x03\x00\x00\x00\x11\x00\x00\x00"
    assert len(file) == 12 + len("thing") + 3 * 16


def test_a_grid_becomes_straight_walls_around_its_zones_and_passages_between_them() -> None:
    text = TWO_ROOMS.text()
    walls = textmap.read_walls(text)
    lengths = np.linalg.norm(walls[:, 1] - walls[:, 0], axis=1)

    assert np.sort(lengths).tolist() == [32] * 6 + [64] * 6
    assert text.count("twosided = true") == 2
    assert walls.min(axis=(0, 1)).tolist() == [0, -96]
    assert walls.max(axis=(0, 1)).tolist() == [160, 0]
    assert TWO_ROOMS.spots() == {10: (32, -32), 11: (128, -32)}


def test_each_wall_has_its_zone_on_its_right() -> None:
    (begin, end), *_ = textmap.read_walls(TWO_ROOMS.text())  # the northern wall of the first room

    assert begin.tolist() == [0, 0]
    assert end.tolist() == [64, 0]


def test_textures_are_replaced_wherever_they_occur_and_nothing_else_is() -> None:
    text = 'sidedef { texturemiddle = "WOOD1"; }\nsector // 0\n{\ntexturefloor = "FLAT1_1";\n}\nthing { x = 1; }'
    expected = text.replace("WOOD1", "STONE2").replace("FLAT1_1", "RROCK16")

    assert textmap.replace_textures(text, {"WOOD1": "STONE2", "FLAT1_1": "RROCK16"}) == expected


def test_no_two_maps_share_a_texture() -> None:
    grid = maps.GRID_B
    sets = [maps._TEXTURES_A, maps.A_V1.textures, maps.A_V2.textures, (*grid.walls.values(), grid.floor, grid.ceiling)]

    assert sum(map(len, sets)) == len(set().union(*sets))


@pytest.mark.parametrize("path", maps.B.routes)
def test_a_way_leads_from_end_to_end_through_free_floor(path: str) -> None:
    floor = floor_between(textmap.read_walls(maps.B.text()))
    begin, end = (np.array(place, np.float64) for place in maps.B.ends(path))

    way = floor.way(begin, end)

    assert way[0].tolist() == begin.tolist()
    assert way[-1].tolist() == end.tolist()
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).max() <= 2 * CELL_UNITS
    assert floor.clearance(way).min() >= CLEAR_UNITS


def test_a_landmark_is_reached_within_48_units_and_45_degrees_of_it() -> None:
    near, far, turned = (100 + 47.9, 50, 359), (100, 50 + 48.1, 0), (100, 50, 46)
    reference = states((100, 50, 1), (100, 50, 1), (100, 50, 0))

    assert PREDICATES["at-landmark"].holds(states(near, far, turned), reference).tolist() == [[True, False, False]]
    assert PREDICATES["at-landmark/32"].holds(states(near, far, turned), reference).tolist() == [[False] * 3]
    assert PREDICATES["at-landmark/64"].holds(states(near, far, turned), reference).tolist() == [[True, True, False]]


def test_a_path_is_walked_by_whoever_began_at_its_beginning_and_was_at_its_end() -> None:
    begin, end = maps.A.ends("path-1")
    walked = states((*begin, 0), (500, -176, 0), (*end, 90), (500, -176, 0))

    assert PREDICATES["completed/path-1"].holds(walked).tolist() == [[False, False, True, True]]
    assert not PREDICATES["completed/path-1"].holds(walked[:, 1:]).any()


@pytest.mark.fault("R6")
def test_a_missing_wheel_is_named_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "vizdoom", None)
    maps.wheel.cache_clear()

    with pytest.raises(FailedPrecondition, match="vizdoom, which is not installed") as caught:
        TASKS[0].make()

    assert caught.value.hint == "pip install --no-deps -r assets-doom.txt"


def test_another_release_of_the_wheel_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in maps._SHA256:
        (tmp_path / "vizdoom" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "vizdoom" / name).write_bytes(b"another")
    (tmp_path / "vizdoom" / "__init__.py").touch()
    monkeypatch.delitem(sys.modules, "vizdoom", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    maps.wheel.cache_clear()

    with pytest.raises(FailedPrecondition, match=r"of vizdoom 1\.3\.2; its file scenarios/my_way_home\.wad is another"):
        TASKS[0].make()
