"""Things on the table: five to grasp, each with the task that uses it and the thing that it is used on.

Lengths are nominal, in metres; each episode scales every thing as a whole.
"""

from dataclasses import dataclass

REACH = "reach"


@dataclass(frozen=True)
class Thing:
    """Something that the gripper grasps.

    Attributes:
        name: Name of its body.
        task: The skill that uses it.
        used_on: Name of the body that the skill uses it on.
        rest_m: Height of its origin, which is its grasp point, when it lies on the table.
        width_m: Distance of the fingers that hold it.
        pitch_rad: How far the hand is inclined when it grasps.
    """

    name: str
    task: str
    used_on: str
    rest_m: float
    width_m: float
    pitch_rad: float


CUP_RADIUS_M, CUP_HALF_M = 0.034, 0.046
SPOON_TIP_M = 0.115
"""Distance of the middle of the spoon's bowl from the grasp point, along the handle."""

BLOCK_HALF_M, BASE_HALF_M = 0.024, 0.032
BALL_RADIUS_M = 0.025
SPONGE_HALF_M = (0.036, 0.026, 0.015)
BOWL_RADIUS_M, BOWL_HEIGHT_M = 0.062, 0.046
POT_RADIUS_M, POT_HEIGHT_M = 0.068, 0.07
BOX_HALF_M, BOX_HEIGHT_M = 0.056, 0.055
SPOT_RADIUS_M, SPOT_PITCH_M = 0.017, 0.03
SPOTS = tuple(f"stain.{i}" for i in range(6))
"""Bodies of the stain's spots, in two rows of three."""

CUP = Thing("cup", "pour", "bowl", CUP_HALF_M, 2 * CUP_RADIUS_M, 0.45)
SPOON = Thing("spoon", "stir", "pot", 0.007, 0.014, 0.65)
BLOCK = Thing("block", "stack", "base", BLOCK_HALF_M, 2 * BLOCK_HALF_M, 1.0)
BALL = Thing("ball", "place", "box", BALL_RADIUS_M, 2 * BALL_RADIUS_M, 0.9)
SPONGE = Thing("sponge", "wipe", "stain", SPONGE_HALF_M[2], 2 * SPONGE_HALF_M[1], 1.0)
THINGS = (CUP, SPOON, BLOCK, BALL, SPONGE)

TASK_SKILLS = tuple(thing.task for thing in THINGS)
FREE_BODIES = ("cup", "spoon", "block", "ball", "sponge", "base")
"""Bodies that move as physics has it."""

PLACED_BODIES = ("bowl", "pot", "box")
"""Bodies that stay where an episode has put them."""

SCALED = (*FREE_BODIES, *PLACED_BODIES, "stain")
"""Everything that has a size and a gray level of its own."""


def thing_of(task: str) -> Thing:
    """Returns the thing that a skill uses."""
    return next(thing for thing in THINGS if thing.task == task)
