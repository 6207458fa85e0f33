"""What a policy is to a robot: what its actions mean, how often it acts, and when it holds a goal for reached."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from freerein.errors import InvalidInput
from freerein.learning.checkpoints import JSON
from freerein.types.common import ActionSpec

_KEY = "handshake"


@dataclass(frozen=True)
class Handshake:
    """What a policy's card says beside its `spec`.

    Attributes:
        action: What an action is.
        control_dt_s: Time between two actions, in seconds.
        reached_threshold: A goal is reached when the probability that it is, is at least this; in [0, 1].
        max_steps_per_goal: Control steps after which a goal is given up, unless a request says otherwise.
    """

    action: ActionSpec
    control_dt_s: float
    reached_threshold: float
    max_steps_per_goal: int

    def __post_init__(self) -> None:
        """Refuses what no robot can shake hands on.

        Raises:
            InvalidInput: A number is out of its range.
        """
        times_are_positive = 0 < self.control_dt_s < math.inf and self.max_steps_per_goal >= 1
        if not (times_are_positive and 0 <= self.reached_threshold <= 1 and self.action.size >= 1):
            raise InvalidInput(
                "A policy must have actions of at least 1 number, `control_dt_s` above 0, `reached_threshold` in "
                "[0, 1] and `max_steps_per_goal` of at least 1; it has not.",
                hint="Fit the model again, or restore its folder from a copy.",
            )

    def to_card(self) -> dict[str, JSON]:
        """Returns the part of a card that `from_card` reads."""
        return {_KEY: asdict(self)}

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> "Handshake":
        """Returns what a card says; it is read as untrusted.

        Raises:
            InvalidInput: It is not what `to_card` writes.
        """
        try:
            document = card[_KEY]
            action = document["action"]
            return cls(
                action=ActionSpec(
                    size=int(action["size"]),
                    choices=int(action["choices"]),
                    names=tuple(str(name) for name in action["names"]),
                    unit=str(action["unit"]),
                    scale=tuple(float(number) for number in action["scale"]),
                ),
                control_dt_s=float(document["control_dt_s"]),
                reached_threshold=float(document["reached_threshold"]),
                max_steps_per_goal=int(document["max_steps_per_goal"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidInput(
                f"A policy's card must hold a `{_KEY}` of action, rate and threshold; it does not.",
                hint="Fit the model again, or restore its folder from a copy.",
            ) from error
