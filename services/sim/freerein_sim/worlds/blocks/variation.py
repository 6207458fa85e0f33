"""Conditions of the blocks tasks, and what they change."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TypeVar

from freerein_sim.worlds.conditions import LIGHT_CONDITIONS, Condition, light_scale

_COUNTS = {f"blocks-{count}": count for count in (2, 3, 4)}
_SPEEDS = {"speed-0.5": 0.5, "speed-2": 2.0}
_SHIFTS_M = {"camera-5cm": 0.05}
_TURNS_DEG = {"camera-3deg": 3.0}
START_UNSEEN, START_ON_THE_WAY = "start-unseen", "start-on-the-way"

T = TypeVar("T")

_SEEN = (
    *LIGHT_CONDITIONS,
    Condition("camera-5cm", "camera", "each camera moved by 5 cm across its view axis, drawn for each episode"),
    Condition("camera-3deg", "camera", "each camera turned by 3 degrees about an axis drawn for each episode"),
    *(Condition(name, "blocks", f"{count} blocks on show") for name, count in _COUNTS.items()),
)
SCATTER_CONDITIONS = _SEEN
FREE_CONDITIONS = (
    *_SEEN,
    Condition("speed-0.5", "speed", "the expert travels at half its speed, in demonstrations twice as long"),
    Condition("speed-2", "speed", "the expert travels at twice its speed, as far as actions go"),
)
GOAL_CONDITIONS = (
    *_SEEN,
    Condition(START_UNSEEN, "start", "each block begins within twice the interval"),
    Condition(START_ON_THE_WAY, "start", "in two of three episodes the gripper is near the first block or holds it"),
)


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
        is_start_on_the_way: Whether episodes may begin near the first block, or holding it.
        speed: Factor of the expert's speed of travel.
    """

    blocks: int
    fewest_blocks: int
    light: float = 1.0
    camera_shift_m: float = 0.0
    camera_turn_deg: float = 0.0
    is_start_unseen: bool = False
    is_start_on_the_way: bool = False
    speed: float = 1.0

    @classmethod
    def of(cls, conditions: Collection[str], *, blocks: int, fewest_blocks: int) -> "Variation":
        """Returns the variation under conditions of a task with numbers of blocks of its own."""
        return cls(
            blocks=_first(_COUNTS, conditions, blocks),
            fewest_blocks=_first(_COUNTS, conditions, fewest_blocks),
            light=light_scale(conditions),
            camera_shift_m=_first(_SHIFTS_M, conditions, 0.0),
            camera_turn_deg=_first(_TURNS_DEG, conditions, 0.0),
            is_start_unseen=START_UNSEEN in conditions,
            is_start_on_the_way=START_ON_THE_WAY in conditions,
            speed=_first(_SPEEDS, conditions, 1.0),
        )


def _first(values: Mapping[str, T], conditions: Collection[str], default: T) -> T:
    return next((value for name, value in values.items() if name in conditions), default)
