"""The spec of the office world: cameras, actions, skills, sizes. Lengths are in metres, headings in degrees."""

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.conditions import LIGHT_CONDITIONS, Condition
from freerein_sim.worlds.repeated_choices import Repeats
from freerein_sim.worlds.world import WorldSpec

STAND_STILL, FORWARD, LEFT, RIGHT = range(4)
EXPLORATION = (Repeats(0.05, 2), *(Repeats(0.95 / 3, 5) for _ in (FORWARD, LEFT, RIGHT)))
"""How the choices are drawn in exploration, and for how many actions each is repeated (appendix A)."""

STEP_M, TURN_DEG = (0.09, 0.11), (14.0, 18.0)
"""Intervals of how far an action drives and turns; each is drawn uniformly."""

ROBOT_RADIUS_M = 0.18
CAMERA_HEIGHT_M, VIEW_DEG = 0.6, 60.0
"""Height of the camera, and its field of view, in both directions."""

MAZE, LOOP = "maze", "loop"
GOALS = tuple(f"goal-{number}" for number in range(1, 11))
ALONG_PATH = "heading-along-path"

CAMERA = "first-person"
SPEC = WorldSpec(
    cameras=(Camera(CAMERA, 64, 64, 3),),
    action=ActionSpec(size=1, choices=4, names=("stand-still", "forward", "left", "right"), hold=STAND_STILL),
    control_dt_s=0.5,
    skills=(*GOALS, MAZE, LOOP),
    max_episode_steps=500,
    state_names=("robot.x", "robot.y", "robot.heading", "contact"),
)

CONDITIONS = (
    *LIGHT_CONDITIONS,
    Condition(ALONG_PATH, "heading", "an episode with a maze or a loop begins where that does, in its direction"),
)
