"""The spec of the tabletop world: cameras, actions, skills, sizes."""

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.tabletop.predicates import STATE_NAMES
from freerein_sim.worlds.tabletop.things import REACH, TASK_SKILLS
from freerein_sim.worlds.world import WorldSpec

CONTROL_DT_S = 0.1
HAND_STEP = (0.15, 0.15, 0.15, 0.8, 0.8)
OPENING_STEP_M = 0.06

SPEC = WorldSpec(
    cameras=(Camera("front", 120, 320, 1),),
    action=ActionSpec(
        size=6,
        choices=0,
        names=("dx", "dy", "dz", "dpitch", "droll", "gripper"),
        unit="m, rad",
        scale=(*HAND_STEP, OPENING_STEP_M),
    ),
    control_dt_s=CONTROL_DT_S,
    skills=(REACH, *TASK_SKILLS),
    max_episode_steps=100,
    state_names=STATE_NAMES,
)
