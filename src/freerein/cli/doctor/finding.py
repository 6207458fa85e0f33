"""What the doctor says of one thing."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """What was found of one thing.

    Attributes:
        name: Of the thing.
        state: `problem` where something that is needed is missing, `warning` where all works that is needed now.
        detail: What was found.
        fix: How to mend it; empty where there is nothing to mend.
    """

    name: str
    state: Literal["ok", "warning", "problem"]
    detail: str
    fix: str = ""
