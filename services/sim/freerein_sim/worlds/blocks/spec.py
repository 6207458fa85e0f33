"""The spec of the blocks world: cameras, actions, skills, sizes."""

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.world import WorldSpec

COLOURS = ("red", "green", "yellow", "blue")
CONTROL_DT_S = 0.04
GRIPPER_STEP_M = 0.05
FINGER_STEP_M = 0.02

_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
STATE_NAMES = (
    *(f"gripper.{part}" for part in ("y", "z", "opening")),
    *(f"{colour}.{part}" for colour in COLOURS for part in _POSE),
)


def block_spec(moved: tuple[str, ...], max_episode_steps: int) -> WorldSpec:
    """Returns the spec of a task whose expert moves blocks of these colours."""
    return WorldSpec(
        cameras=tuple(Camera(name, 64, 64, 3) for name in ("front", "left", "tilt")),
        action=ActionSpec(
            size=3,
            choices=0,
            names=("dy", "dz", "gripper"),
            unit="m",
            scale=(GRIPPER_STEP_M, GRIPPER_STEP_M, FINGER_STEP_M),
        ),
        control_dt_s=CONTROL_DT_S,
        skills=tuple(f"move-{colour}" for colour in moved),
        max_episode_steps=max_episode_steps,
        state_names=STATE_NAMES,
    )
