"""What fits and runs have in common: they take their time, in steps, and their metrics change."""

from collections.abc import Mapping
from typing import Protocol


class Underway(Protocol):
    """A fit or a run, as it stands."""

    @property
    def id(self) -> str:
        """32 hexadecimal digits."""

    @property
    def state(self) -> str:
        """Where it stands."""

    @property
    def step(self) -> int:
        """Steps made."""

    @property
    def steps(self) -> int:
        """Steps planned."""

    @property
    def metrics(self) -> Mapping[str, float]:
        """The latest metrics."""

    @property
    def error(self) -> str:
        """Why it failed, else empty."""

    @property
    def ended(self) -> bool:
        """Whether nothing more will happen to it."""


def steps_of(now: Underway) -> str:
    """Returns the steps made, of those planned where that is known, such as `3/10`."""
    return f"{now.step}/{now.steps}" if now.steps else str(now.step)
