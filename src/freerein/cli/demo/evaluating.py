"""What a policy earns in a task, by the oracle's reward: for evaluation, no learner comes near it."""

from dataclasses import dataclass
from typing import Any

from freerein.cli.demo.context import HELD_OUT, Context
from freerein.cli.demo.runs import artifact, finish_run, start_run

_EPISODES = 50


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


async def evaluate(context: Context, name: str, task: str, policy: str | dict[str, Any]) -> Earned:
    """Returns what a policy earns from 50 starts that nobody has learned from, the same for every policy.

    Args:
        context: Where the demo runs.
        name: What is evaluated, as it is called on screen.
        task: Where.
        policy: "random", or whose, as the orchestrator's kind `evaluate` takes it.
    """
    config = {
        "task": task,
        "policy": policy,
        "episodes": _EPISODES,
        "num_envs": _EPISODES,
        "seed": context.seed + HELD_OUT,
    }
    run = await start_run(context, "evaluate", config)
    await finish_run(context, f"evaluate {name}", run)
    result = await artifact(context, run, "result.json")
    return Earned(result["return_mean"], result["return_low"], result["return_high"], result["success_rate"])
