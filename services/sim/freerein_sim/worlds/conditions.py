"""Conditions: named variations of a task, with which a session can be created; each task declares a closed list.

Conditions of one group exclude each other. Their order does not matter.
"""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from freerein.errors import must_be


@dataclass(frozen=True)
class Condition:
    """A variation.

    Attributes:
        name: Its name within the task.
        group: At most one condition of a group is chosen.
        text: What it does, as a phrase.
    """

    name: str
    group: str
    text: str


LIGHTS = {f"light-{scale}": scale for scale in (0.6, 0.8, 1.2, 1.4)}
"""Conditions of MuJoCo worlds: by name, the factor of all lights' diffuse and ambient parts."""

LIGHT_CONDITIONS = tuple(
    Condition(name, "light", f"all lights {scale} times as bright") for name, scale in LIGHTS.items()
)

CAMERA_SHIFTED = Condition(
    "camera-5cm", "camera", "each camera moved by 5 cm across its view axis, drawn for each episode"
)
CAMERA_TURNED = Condition(
    "camera-3deg", "camera", "each camera turned by 3 degrees about an axis drawn for each episode"
)
CAMERA_CONDITIONS = (CAMERA_SHIFTED, CAMERA_TURNED)
CAMERA_SHIFT_M, CAMERA_TURN_DEG = 0.05, 3.0
"""Conditions of MuJoCo worlds whose cameras may move, and by how much."""


def light_scale(conditions: Collection[str]) -> float:
    """Returns the factor of the lights under conditions."""
    return next((scale for name, scale in LIGHTS.items() if name in conditions), 1.0)


def check_conditions(declared: Sequence[Condition], chosen: Sequence[str]) -> frozenset[str]:
    """Returns the conditions chosen.

    Raises:
        InvalidInput: One is not declared, or two are of one group.
    """
    groups = {condition.name: condition.group for condition in declared}
    if unknown := sum(name not in groups for name in chosen):
        got = f"{unknown} others" if unknown > 1 else "another"
    elif twice := [group for group, count in Counter(groups[name] for name in chosen).items() if count > 1]:
        got = f"several of the group {twice[0]}"
    else:
        return frozenset(chosen)
    hint = f"There are {_listed(declared) or 'none'}."
    raise must_be("conditions", "among the task's, at most one of each group", got, hint=hint)


def _listed(declared: Sequence[Condition]) -> str:
    """Returns names by group, such as `blur; warm, cool`."""
    groups: dict[str, list[str]] = {}
    for condition in declared:
        groups.setdefault(condition.group, []).append(condition.name)
    return "; ".join(", ".join(names) for names in groups.values())
