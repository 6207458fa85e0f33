"""What every trajectory of a dataset has in common."""

import json
from dataclasses import asdict, dataclass

import numpy as np

from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec, check_name


@dataclass(frozen=True)
class DatasetSpec:
    """What every trajectory of a dataset has in common.

    Attributes:
        fps: Timesteps per second, a positive integer as LeRobot wants it; see `integer_fps`.
        cameras: Frame size (H, W, C) in pixels by camera name, C = 1 or 3.
        action: What an action is: its size, or its number of choices when it is discrete.
        robot_type: What robot acted.
        skills: The vocabulary of skills; labels are indices into it. Empty when the dataset has none.
        task: What was to be done, in words, in trajectories that do not say it themselves.
    """

    fps: int
    cameras: dict[str, tuple[int, int, int]]
    action: ActionSpec
    robot_type: str
    skills: tuple[str, ...] = ()
    task: str = ""

    def __post_init__(self) -> None:
        """Refuses what cannot be stored.

        Raises:
            InvalidInput: A value is out of its range.
        """
        if self.fps < 1:
            raise InvalidInput(f"`fps` must be a positive integer; got {self.fps}.", field="fps")
        if not self.cameras:
            raise InvalidInput("`cameras` must name at least one camera; got none.", field="cameras")
        for name, (height, width, channels) in self.cameras.items():
            check_name(name, field="cameras")
            if height < 1 or width < 1 or channels not in (1, 3):
                raise InvalidInput(
                    f"A camera's frames must be (H, W, C) with C = 1 or 3; got ({height}, {width}, {channels}).",
                    field="cameras",
                )
        if len(set(self.skills)) != len(self.skills) or "" in self.skills:
            raise InvalidInput(
                "`skills` must be different, non-empty names; got a repeated or empty one.", field="skills"
            )
        if self.action.size < 1 or (self.action.choices and self.action.size != 1):
            raise InvalidInput(
                "An action must have at least one number, and exactly one when it is discrete; "
                f"got {self.action.size} with {self.action.choices} choices.",
                field="action",
            )

    @property
    def action_dtype(self) -> np.dtype[np.float32] | np.dtype[np.int64]:
        """The dtype of actions: float32 where continuous, int64 where discrete."""
        return np.dtype(np.int64) if self.action.choices else np.dtype(np.float32)


def integer_fps(control_dt_s: float) -> int:
    """Returns the integer rate nearest to a control period, in timesteps per second.

    Raises:
        InvalidInput: The period is not between 0 (excluded) and 2 seconds.
    """
    if not 0 < control_dt_s < 2:
        raise InvalidInput(
            f"`control_dt_s` must be above 0 and below 2 seconds; got {control_dt_s}.",
            field="control_dt_s",
            hint="A dataset needs a rate of at least one timestep per second.",
        )
    return round(1 / control_dt_s)


def dumps(spec: DatasetSpec) -> str:
    """Returns a spec as JSON text."""
    return json.dumps(asdict(spec), indent=2)


def loads(text: str | bytes) -> DatasetSpec:
    """Returns the spec that `dumps` wrote.

    Raises:
        InvalidInput: The text is no such spec.
    """
    try:
        document = json.loads(text)
        action = document["action"]
        return DatasetSpec(
            fps=int(document["fps"]),
            cameras={name: (int(h), int(w), int(c)) for name, (h, w, c) in document["cameras"].items()},
            action=ActionSpec(
                size=int(action["size"]),
                choices=int(action["choices"]),
                names=tuple(action["names"]),
                unit=str(action["unit"]),
                scale=tuple(action["scale"]),
            ),
            robot_type=str(document["robot_type"]),
            skills=tuple(document["skills"]),
            task=str(document["task"]),
        )
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InvalidInput(
            "The dataset's description must be the JSON that freerein wrote; it cannot be read.",
            hint="Delete the dataset's meta folder: it is rebuilt from the data files.",
        ) from None
