"""The spec of the push world: cameras, actions, skills, sizes."""

from collections.abc import Sequence

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.push.things import Thing
from freerein_sim.worlds.recipes import FixedOrder
from freerein_sim.worlds.world import WorldSpec

CONTROL_DT_S = 0.1
HAND_STEP_M = 0.05
RECIPE = FixedOrder(("reach", "push"))

_HAND = tuple(f"gripper.{axis}" for axis in "xyz")
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


def push_spec(things: Sequence[Thing], *, skills: tuple[str, ...], max_episode_steps: int) -> WorldSpec:
    """Returns the spec of a task with these things; those that an episode does not show are in its true state, too."""
    return WorldSpec(
        cameras=tuple(Camera(name, 64, 64, 3) for name in ("front", "left", "right")),
        action=ActionSpec(size=2, choices=0, names=("dx", "dy"), unit="m", scale=(HAND_STEP_M, HAND_STEP_M)),
        control_dt_s=CONTROL_DT_S,
        skills=skills,
        max_episode_steps=max_episode_steps,
        state_names=(*_HAND, *(f"{thing.name}.{part}" for thing in things for part in _POSE)),
    )
