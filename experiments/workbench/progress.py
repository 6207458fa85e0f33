"""Which arms of an experiment have results, and how long the others may take."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Literal

from experiments.workbench import results
from experiments.workbench.arms import Arm, Experiment, is_current
from experiments.workbench.results import ArmResult

State = Literal["present", "outdated", "missing"]


@dataclass(frozen=True)
class ArmProgress:
    """An arm and its result.

    Attributes:
        arm: The arm.
        state: `outdated` where another configuration or another version of the world made the result.
        minutes: Wall-clock time of the result; of an arm without, the median of other seeds', None where there is none.
    """

    arm: Arm
    state: State
    minutes: float | None


@dataclass(frozen=True)
class Progress:
    """The arms of an experiment."""

    arms: Sequence[ArmProgress]

    @property
    def unfinished(self) -> list[ArmProgress]:
        """Arms that the next `run` trains."""
        return [each for each in self.arms if each.state != "present"]

    @property
    def minutes(self) -> float:
        """Wall-clock time of the current results."""
        return sum(each.minutes or 0.0 for each in self.arms if each.state == "present")

    @property
    def status(self) -> str:
        """`complete`, else how many arms are outdated and missing; what it is without arms of its own."""
        if not self.arms:
            return "no arms: it shows other experiments' results"
        states = [each.state for each in self.unfinished]
        counts = {state: states.count(state) for state in ("outdated", "missing") if state in states}
        return ", ".join(f"{count} {state}" for state, count in counts.items()) or "complete"


def progress(experiment: Experiment, arms: Sequence[Arm], folder: Path) -> Progress:
    """Returns the progress of some arms of an experiment, whose results lie in a folder."""
    found = {each.name: each for each in results.load_all(folder)}
    return Progress([_progress_of(experiment, arm, found.get(arm.name), list(found.values())) for arm in arms])


def _progress_of(
    experiment: Experiment, arm: Arm, result: ArmResult | None, others: Sequence[ArmResult]
) -> ArmProgress:
    if result is not None:
        return ArmProgress(arm, "present" if is_current(experiment, arm, result) else "outdated", result.minutes)
    of_arm = (arm.world, arm.method, dict(arm.options))
    alike = [each.minutes for each in others if (each.world, each.method, dict(each.options)) == of_arm]
    return ArmProgress(arm, "missing", median(alike) if alike else None)
