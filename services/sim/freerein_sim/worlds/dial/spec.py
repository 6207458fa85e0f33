"""The spec of the dial world: cameras, actions, skills, sizes."""

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.dial.keypad import DIGITS
from freerein_sim.worlds.recipes import RandomOrder
from freerein_sim.worlds.world import WorldSpec

CONTROL_DT_S = 0.04
TORQUE_NM = (30.0, 30.0, 30.0, 7.0, 7.0, 7.0)
"""Greatest torque of each joint; the arm's data sheet has 30.5 and 6.8."""

_JOINTS = tuple(f"joint-{number}" for number in range(1, 7))

SPEC = WorldSpec(
    cameras=(Camera("front", 112, 112, 1),),
    action=ActionSpec(size=len(_JOINTS), choices=0, names=_JOINTS, unit="N m", scale=TORQUE_NM),
    control_dt_s=CONTROL_DT_S,
    skills=tuple(f"press-{digit}" for digit in DIGITS),
    max_episode_steps=100,
    state_names=(
        *(f"{joint}.angle" for joint in _JOINTS),
        *(f"fingertip.{axis}" for axis in "xyz"),
        *(f"key-{digit}.depth" for digit in DIGITS),
    ),
)

RECIPES = RandomOrder(most=5)
"""More keys do not fit into an episode."""
