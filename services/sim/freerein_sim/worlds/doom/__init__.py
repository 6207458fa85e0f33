"""The dissertation's 3D navigation (chapter 3, appendix A): rooms and corridors in ViZDoom, seen in first person.

`doom` is map A, my_way_home, in which data are collected. `doom.v1` and `doom.v2` are the same map with other textures,
and `doom.b` is another map with textures of its own. A skill is a path from one room to another. The engine is started
when an episode begins; ViZDoom is imported when a world is made.
"""

from collections.abc import Collection
from functools import lru_cache, partial

from freerein_sim.worlds.doom import maps, textmap
from freerein_sim.worlds.doom.floor import floor_between
from freerein_sim.worlds.doom.maps import DoomMap
from freerein_sim.worlds.doom.predicates import predicates_of
from freerein_sim.worlds.doom.spec import EXPLORATION, spec_of, start_conditions
from freerein_sim.worlds.recipes import RandomOrder
from freerein_sim.worlds.repeated_choices import repeat_choices
from freerein_sim.worlds.replay import ReplayedWorld
from freerein_sim.worlds.walkable_grid import WalkableGrid
from freerein_sim.worlds.world import TaskDefinition, World

VERSION = 1
"""Version of the world; raised where it behaves differently."""


def _make(doom_map: DoomMap, conditions: Collection[str] = ()) -> World:
    maps.wheel()
    from freerein_sim.worlds.doom import expert, simulation

    spec, floor = spec_of(doom_map.routes), _floor(doom_map)
    return ReplayedWorld(simulation.DoomWorld(spec, doom_map, floor, expert.PathExpert, conditions))


@lru_cache(maxsize=4)
def _floor(doom_map: DoomMap) -> WalkableGrid:
    return floor_between(textmap.read_walls(doom_map.text()))


def _task(name: str, doom_map: DoomMap) -> TaskDefinition:
    return TaskDefinition(
        name,
        "doom",
        "",
        spec_of(doom_map.routes),
        partial(_make, doom_map),
        predicates_of(doom_map),
        start_conditions(doom_map.spots),
        RandomOrder(most=1),
        VERSION,
        partial(repeat_choices, EXPLORATION),
        reward_free=True,
    )


TASKS = (_task("doom", maps.A), _task("doom.v1", maps.A_V1), _task("doom.v2", maps.A_V2), _task("doom.b", maps.B))
