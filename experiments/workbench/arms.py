"""An arm: one training, and the evaluation of what it made."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

from experiments.workbench.configs import Config, is_same
from experiments.workbench.results import ArmResult, Outcome
from experiments.workbench.table import Table
from freerein.errors import NotFound, quoted
from freerein_sim.worlds.tasks import tasks


@dataclass(frozen=True)
class Arm:
    """One cell of an experiment's design.

    Attributes:
        world: Task of the sim service whose data it learns from.
        method: Name of the method.
        options: What else tells the arms of an experiment apart, in the same order in all.
        seed: Seed of every random draw of the training.
    """

    world: str
    method: str
    options: Mapping[str, str] = field(default_factory=dict)
    seed: int = 0

    @property
    def name(self) -> str:
        """The arm's name, such as `grid-lse-causal-seed0`."""
        return "-".join([self.world, self.method, *self.options.values(), f"seed{self.seed}"])


class Experiment(ABC):
    """Arms, how one is run, and the table of their results. One without arms shows results of others."""

    @property
    def arms(self) -> Sequence[Arm]:
        """All arms, in the order in which they run."""
        return ()

    @property
    def sources(self) -> Sequence[str]:
        """Names of other experiments whose results its table shows, too."""
        return ()

    def config(self, arm: Arm) -> Config:
        """Returns everything that the arm's result depends on, beside its name, the world and the code."""
        raise NotFound("The experiment must have arms; it shows results of others.", hint="Run those.")

    def prepare(self, arm: Arm, work: Path) -> bool:
        """Makes what an arm shares with others, such as datasets, unless it is there; its time is no arm's.

        Returns False when it was stopped by SIGTERM.
        """
        return True

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Trains an arm, or resumes it, and evaluates it; returns None when it was stopped by SIGTERM.

        Args:
            arm: One of `arms`.
            results: Folder of the experiment's results, for what arms choose together.
            work: Folder that all arms share, for datasets; see `prepare`.
            folder: Folder of this arm, for checkpoints.
            on_progress: Called now and then.
        """
        raise NotFound("The experiment must have arms; it shows results of others.", hint="Run those.")

    @abstractmethod
    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns the table of its arms, and of its sources', that have results, at least one.

        All are current, see `is_current`.
        """


def is_current(experiment: Experiment, arm: Arm, result: ArmResult) -> bool:
    """Returns whether the arm's present configuration made a result, in the world's present version."""
    is_made_here = result.world_version == world_version(arm.world)
    return is_made_here and is_same(dict(result.config), experiment.config(arm))


@cache
def world_version(world: str) -> str:
    """Returns name and version of the world of a task, such as `blocks-v1`."""
    return tasks()[world].world_version


def choose(experiment: Experiment, patterns: Sequence[str]) -> list[Arm]:
    """Returns the arms whose name matches one of the shell patterns, all arms without patterns.

    Raises:
        NotFound: A pattern matches no arm.
    """
    for pattern in patterns:
        if not any(fnmatch(arm.name, pattern) for arm in experiment.arms):
            raise NotFound(
                f"A pattern must match one of {len(experiment.arms)} arms; {quoted(pattern)} matches none.",
                field="only",
                hint=f"An arm's name is like {experiment.arms[0].name}.",
            )
    return [arm for arm in experiment.arms if not patterns or any(fnmatch(arm.name, each) for each in patterns)]
