"""The spec of the bins world: cameras, actions, skills, sizes."""

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.bins.layout import GROCERIES
from freerein_sim.worlds.world import WorldSpec

CONTROL_DT_S = 0.25
GRIPPER_STEP_M = 0.25
FINGER_STEP_M = 0.0325

_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")

SPEC = WorldSpec(
    cameras=(Camera("agentview", 128, 128, 3),),
    action=ActionSpec(
        size=4,
        choices=0,
        names=("dx", "dy", "dz", "gripper"),
        unit="m",
        scale=(GRIPPER_STEP_M, GRIPPER_STEP_M, GRIPPER_STEP_M, FINGER_STEP_M),
    ),
    control_dt_s=CONTROL_DT_S,
    skills=tuple(f"move-{each.name}" for each in GROCERIES),
    max_episode_steps=100,
    state_names=(
        *(f"gripper.{part}" for part in ("x", "y", "z", "opening")),
        *(f"{each.name}.{part}" for each in GROCERIES for part in _POSE),
    ),
)
