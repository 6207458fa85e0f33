"""The spec of the doom world: cameras, actions, skills, sizes. Lengths are in map units, headings in degrees."""

from collections.abc import Collection

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.conditions import Condition
from freerein_sim.worlds.repeated_choices import Repeats
from freerein_sim.worlds.world import WorldSpec

TICS = 4
"""Tics of the engine that an action is held for."""

TICS_PER_S = 35
NO_OP, FORWARD, LEFT, RIGHT = range(4)
EXPLORATION = (Repeats(0.05, 2), *(Repeats(0.95 / 3, 5) for _ in (FORWARD, LEFT, RIGHT)))
"""How the choices are drawn in exploration, and for how many actions each is repeated (appendix A)."""

ENGINE_HEIGHT = 120
ALONG_PATH = "heading-along-path"
_START = "start-room-"


def spec_of(paths: Collection[str]) -> WorldSpec:
    """Returns the spec of a task with these paths."""
    return WorldSpec(
        cameras=(Camera("first-person", 42, 42, 1),),
        action=ActionSpec(size=1, choices=4, names=("no-op", "forward", "left", "right"), hold=NO_OP),
        control_dt_s=TICS / TICS_PER_S,
        skills=tuple(paths),
        max_episode_steps=525,
        state_names=("agent.x", "agent.y", "agent.heading"),
        max_size=ENGINE_HEIGHT,
    )


def start_conditions(spots: Collection[int]) -> tuple[Condition, ...]:
    """Returns the conditions of where an episode begins, and in which direction."""
    rooms = (Condition(f"{_START}{spot}", "start", f"an episode begins at spot {spot} of the map") for spot in spots)
    return (*rooms, Condition(ALONG_PATH, "heading", "an episode with a path begins in the path's direction"))


def start_spot(conditions: Collection[str]) -> int | None:
    """Returns the spot that a condition names, None without one."""
    return next((int(name.removeprefix(_START)) for name in conditions if name.startswith(_START)), None)
