"""What policies earn in tasks, by the oracle's reward: for evaluation, no learner comes near it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from freerein.cli.demo.context import HELD_OUT, Context
from freerein.cli.demo.runs import artifact, finish_run, start_run

Step = Mapping[str, object]
"""A step of a run of kind `pipeline`."""

_EPISODES = 50


@dataclass(frozen=True)
class Entrant:
    """Who is evaluated, where.

    Attributes:
        task: The task's name.
        policy: "random", or whose, as the orchestrator's kind `evaluate` takes it.
    """

    task: str
    policy: str | dict[str, Any]


@dataclass(frozen=True)
class Earned:
    """What a policy earned per episode.

    Attributes:
        mean: Of the returns: how many control steps the goal held.
        low: The lower end of the mean's 95 % interval.
        high: Its upper end.
        success_rate: The share of episodes at whose end the goal holds.
    """

    mean: float
    low: float
    high: float
    success_rate: float


async def start_evaluations(context: Context, entrants: Mapping[str, Entrant], *, before: Sequence[Step] = ()) -> str:
    """Starts a run that has each entrant begin 50 times where nobody has learned, the same for all; returns its id.

    Args:
        context: Where the demo runs.
        entrants: By name.
        before: What the run does first.
    """
    steps = [{"name": name, "kind": "evaluate", "config": _config(context, each)} for name, each in entrants.items()]
    return await start_run(context, "pipeline", {"steps": [*before, *steps]})


async def finish_evaluations(context: Context, title: str, run: str, names: Iterable[str]) -> dict[str, Earned]:
    """Returns what entrants have earned, by name, once the run is done."""
    await finish_run(context, title, run)
    return {name: await _earned(context, run, name) for name in names}


def name_of(task: str) -> str:
    """Returns the name of those steps that are about a task."""
    return task.rpartition(".")[2]


def _config(context: Context, entrant: Entrant) -> dict[str, object]:
    return {
        "task": entrant.task,
        "policy": entrant.policy,
        "episodes": _EPISODES,
        "num_envs": _EPISODES,
        "seed": context.seed + HELD_OUT,
    }


async def _earned(context: Context, run: str, name: str) -> Earned:
    result = await artifact(context, run, f"{name}.result.json")
    return Earned(result["return_mean"], result["return_low"], result["return_high"], result["success_rate"])
