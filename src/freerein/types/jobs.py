"""What fits and runs have in common: their states and their metrics."""

from dataclasses import dataclass, field
from typing import Literal

JobState = Literal["queued", "running", "succeeded", "failed", "cancelled"]
ENDED: tuple[JobState, ...] = ("succeeded", "failed", "cancelled")


@dataclass(frozen=True)
class MetricRow:
    """Metrics of one step.

    Attributes:
        step: Step, counted from 1; 0 for what precedes the first step.
        metrics: Value of each metric by name; finite.
    """

    step: int
    metrics: dict[str, float] = field(default_factory=dict)
