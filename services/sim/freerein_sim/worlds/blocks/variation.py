"""Conditions of the blocks tasks, and what they change."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any, Literal

from freerein_sim.worlds.conditions import (
    CAMERA_SHIFT_M,
    CAMERA_SHIFTED,
    CAMERA_TURN_DEG,
    CAMERA_TURNED,
    LIGHT_CONDITIONS,
    Condition,
    light_scale,
)

Begin = Literal["own", "near", "held"]
"""How an episode of a goal task begins: as the task has it, with the gripper on its way to the block that the goal
moves, or with that block in the gripper, anywhere."""

_NEAR = "in half of the episodes the gripper is near the first block"
_ON_THE_WAY = "in two of three episodes the gripper is near the first block or holds it"
_SEEN: dict[Condition, dict[str, Any]] = {
    CAMERA_SHIFTED: {"camera_shift_m": CAMERA_SHIFT_M},
    CAMERA_TURNED: {"camera_turn_deg": CAMERA_TURN_DEG},
    **{
        Condition(f"blocks-{count}", "blocks", f"{count} blocks on show"): {"blocks": count, "fewest_blocks": count}
        for count in (2, 3, 4)
    },
}
_SPEEDS: dict[Condition, dict[str, Any]] = {
    Condition("speed-0.5", "speed", "the expert travels at half its speed, in demonstrations twice as long"): {
        "speed": 0.5
    },
    Condition("speed-2", "speed", "the expert travels at twice its speed, as far as actions go"): {"speed": 2.0},
}
_STARTS: dict[Condition, dict[str, Any]] = {
    Condition("start-unseen", "start", "each block begins within twice the interval"): {"is_start_unseen": True},
    Condition("start-near", "start", _NEAR): {"begins": ("own", "near")},
    Condition("start-on-the-way", "start", _ON_THE_WAY): {"begins": ("own", "near", "held")},
}
_DISTRACTORS: dict[Condition, dict[str, Any]] = {
    Condition(
        "ball", "distractor", "a ball in a block's colour, drawn for each episode, on the table behind the blocks"
    ): {"distractor": "ball"},
    Condition("picture", "distractor", "a round picture in a block's colour, drawn for each episode, on the wall"): {
        "distractor": "picture"
    },
}
"""Conditions, and the fields of `Variation` that they set."""

_ALL_CONDITIONS = (*LIGHT_CONDITIONS, *_SEEN)
SCATTER_CONDITIONS = (*_ALL_CONDITIONS, *_DISTRACTORS)
FREE_CONDITIONS = (*_ALL_CONDITIONS, *_SPEEDS)
GOAL_CONDITIONS = (*_ALL_CONDITIONS, *_STARTS)


@dataclass(frozen=True)
class Variation:
    """How a world differs from the nominal one.

    Attributes:
        blocks: Largest number of blocks on show.
        fewest_blocks: Smallest one; the number is drawn for each episode.
        light: Factor of all lights.
        camera_shift_m: How far each camera is moved.
        camera_turn_deg: How far each camera is turned.
        is_start_unseen: Whether blocks begin within the wider interval.
        begins: How episodes may begin; empty for as the task has it.
        speed: Factor of the expert's speed of travel.
        distractor: Kind of the distractor that is shown; empty for none.
    """

    blocks: int
    fewest_blocks: int
    light: float = 1.0
    camera_shift_m: float = 0.0
    camera_turn_deg: float = 0.0
    is_start_unseen: bool = False
    begins: tuple[Begin, ...] = ()
    speed: float = 1.0
    distractor: str = ""

    @classmethod
    def of(cls, conditions: Collection[str], *, blocks: int, fewest_blocks: int) -> "Variation":
        """Returns the variation under conditions of a task with numbers of blocks of its own."""
        variation = cls(blocks, fewest_blocks, light=light_scale(conditions))
        for condition, changes in (_SEEN | _SPEEDS | _STARTS | _DISTRACTORS).items():
            if condition.name in conditions:
                variation = replace(variation, **changes)
        return variation
