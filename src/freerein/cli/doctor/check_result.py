"""Result of one check."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class CheckResult:
    """Result of one check.

    Attributes:
        name: What was checked.
        state: `problem` where something required is missing; `warning` where nothing required is.
        detail: What was found.
        fix: How to fix it; empty where nothing needs fixing.
    """

    name: str
    state: Literal["ok", "warning", "problem"]
    detail: str
    fix: str = ""
