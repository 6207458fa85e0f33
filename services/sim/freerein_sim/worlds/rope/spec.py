"""The spec of the rope world: cameras, actions, skills, sizes. Lengths are in metres."""

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.conditions import CAMERA_CONDITIONS, LIGHT_CONDITIONS, Condition
from freerein_sim.worlds.world import WorldSpec

LINKS, LINK_M, RADIUS_M = 25, 0.024, 0.0075
POINTS = LINKS + 1
"""Points of the true state: the ends of the links, in order along the rope."""

REACH_M = 0.33
"""Greatest distance of a pick and of a place from the middle of the table, along x and y."""

LONGEST_M = 0.15
"""Greatest displacement along x, and along y. In the dissertation's data the longest is as long."""

KNOT, S_SHAPE = "knot", "s-shape"
FROM_LEFT = "start-from-left"

SPEC = WorldSpec(
    cameras=(Camera("above", 64, 64, 3),),
    action=ActionSpec(
        size=4, choices=0, names=("x", "y", "dx", "dy"), unit="m", scale=(REACH_M, REACH_M, LONGEST_M, LONGEST_M)
    ),
    control_dt_s=1.0,
    skills=(KNOT, S_SHAPE),
    max_episode_steps=40,
    state_names=tuple(f"point-{point:02}.{axis}" for point in range(POINTS) for axis in "xyz"),
)

CONDITIONS = (
    *LIGHT_CONDITIONS,
    *CAMERA_CONDITIONS,
    Condition(FROM_LEFT, "start", "an episode with a recipe begins with the rope nearly straight, from left to right"),
)
