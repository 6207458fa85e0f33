"""The 18 teachers of chapter 4: policies for each relation of two of three colours, by PPO on a learned reward.

Blocks begin as the task has them; in half of the training episodes the gripper begins near the block that it moves.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import Any

from experiments.robustness.evaluated import evaluate
from experiments.robustness.worlds import NEAR
from experiments.workbench import claims
from experiments.workbench.arms import Arm, Experiment
from experiments.workbench.claims import Claim
from experiments.workbench.configs import Config
from experiments.workbench.pipelines import Step, run_pipeline, step
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult, Outcome, Sample
from experiments.workbench.table import Picture, Section, Table, words

RELATIONS, COLOURS = ("left-of", "right-of", "on-top-of"), ("red", "green", "yellow")
"""Of the training tasks; blue is for tests (section 4.6)."""

TASKS = tuple(
    f"blocks.{first}-{relation}-{second}" for relation in RELATIONS for first, second in permutations(COLOURS, 2)
)
SEEN, UNSEEN = "seen", "unseen"
STARTS: Mapping[str, Mapping[str, Any]] = {SEEN: {}, UNSEEN: {"conditions": ["start-unseen"]}}
"""What evaluations begin with: blocks within the interval that training has, and within twice that."""

_CARRY_WEIGHT = 1.0
"""Of shaping by how near the first block is to its place."""

_METHOD, _VERSION, _EPISODES, _PER_CENT = "ppo", 1, 100, 100
_LEAST_MEAN, _LEAST_WORST = 75.0, 40.0
_HEADER = ("task", "seed", *(f"{starts} starts, % of the expert" for starts in STARTS), "minutes")


class Teachers(Experiment):
    """An arm for each task, each with one seed."""

    @property
    def arms(self) -> tuple[Arm, ...]:
        """The teachers, relation after relation."""
        return tuple(Arm(task, _METHOD) for task in TASKS)

    def config(self, arm: Arm) -> Config:
        """Returns the steps of the arm's pipeline."""
        return {"version": _VERSION, "steps": _steps(arm)}

    def run(
        self, arm: Arm, *, results: Path, work: Path, folder: Path, on_progress: Callable[[], None]
    ) -> Outcome | None:
        """Trains a teacher, and evaluates it on true states; see `Experiment`."""
        trials = run_pipeline(_steps(arm), folder, on_progress)
        return None if trials is None else Outcome({}, {name: _returns(trials[name]) for name in STARTS})

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns a row for each teacher that has a result, and the claims."""
        rows = tuple(_cells(each) for each in results)
        made = tuple(_claims(results))
        draw = partial(interval_plot, list(made), title="Teachers", unit="per cent of the expert's return")
        return Table(
            title="The teachers of chapter 4",
            text=words("teachers"),
            sections=(Section(_HEADER, rows),),
            claims=made,
            picture=Picture("Returns of the teachers", draw),
        )


def _steps(arm: Arm) -> list[Step]:
    policy = {"policy": {"run": "ppo"}, "baseline": "random", "episodes": _EPISODES}
    return [
        step("ppo", "ppo", task=arm.world, conditions=[NEAR], carry_weight=_CARRY_WEIGHT, seed=arm.seed),
        *(evaluate("returns", name, task=arm.world, **policy, **starts) for name, starts in STARTS.items()),
    ]


def _returns(trials: Sequence[Mapping[str, Any]]) -> Sample:
    """Returns the returns as a share of the expert's in the same episodes."""
    return Sample([each["episode_return"] for each in trials], [each["expert_return"] for each in trials])


def _cells(result: ArmResult) -> tuple[str, ...]:
    shown = []
    for starts in STARTS:
        sample = result.samples[starts]
        low, high = claims.interval([sample])
        value = _PER_CENT * sample.mean
        shown.append(f"{value:.1f} [{_PER_CENT * low:.1f}, {_PER_CENT * high:.1f}]")
    return result.world, str(result.seed), *shown, f"{result.minutes:.0f}"


def _claims(results: Sequence[ArmResult]) -> Iterator[Claim]:
    """Yields means over tasks, whose intervals are over tasks and episodes, and the worst task of the seen starts."""
    more: dict[str, Any] = {"unit": _PER_CENT, "seeds": 1, "command": "python -m experiments run teachers"}
    worst = min(results, key=lambda result: result.samples[SEEN].mean)
    is_complete = len(results) == len(TASKS)
    for name, arms, starts, least in (
        ("teachers", results, SEEN, _LEAST_MEAN),
        ("teachers_worst", [worst], SEEN, _LEAST_WORST),
        ("teachers_unseen", results, UNSEEN, None),
    ):
        samples = [arm.samples[starts] for arm in arms]
        met = None if least is None else is_complete and _PER_CENT * claims.mean(samples) >= least
        yield claims.claim_of(name, arms, samples, target=least, met=met, **more)


EXPERIMENT = Teachers()
