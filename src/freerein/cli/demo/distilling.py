"""Distillation in the demo: rollouts of policies that know one task each, in; a policy that is told in words, out."""

import time
from collections.abc import Mapping
from dataclasses import dataclass

from freerein.cli.demo.context import Context
from freerein.cli.demo.evaluating import Earned, evaluate
from freerein.cli.demo.reinforcing import TASK, Reinforced
from freerein.cli.demo.runs import finish_run, start_run

SHIPPED_TEACHERS: Mapping[str, str] = {"blocks.yellow-right-of-green": "yellow-right-of-green"}
"""By task, the policies that came with freerein and teach beside the one that the demo has learned."""

_ROLLOUTS, _UPDATES = 50, 600


@dataclass(frozen=True)
class Distilled:
    """What came of distillation.

    Attributes:
        earned: By task, what the student earns by the oracle's reward, told by the task's goal text what to do.
        random: By task, what random actions earn.
        training_s: How long the rollouts and the fit took, in seconds.
    """

    earned: Mapping[str, Earned]
    random: Mapping[str, Earned]
    training_s: float

    @property
    def mean(self) -> float:
        """What the student earns per episode, over all tasks."""
        return _mean(self.earned)

    @property
    def random_mean(self) -> float:
        """What random actions earn."""
        return _mean(self.random)


async def distill(context: Context, reinforced: Reinforced) -> Distilled:
    """Teaches a language policy what policies of single tasks do, and measures it in each of these."""
    config = {
        "teachers": [reinforced.run, *SHIPPED_TEACHERS.values()],
        "rollouts": _ROLLOUTS,
        "num_envs": _ROLLOUTS,
        "is_stochastic": True,
        "seed": context.seed,
        "config": {"steps": _UPDATES},
    }
    begun = time.perf_counter()
    run = await start_run(context, "distill", config)
    await finish_run(context, "distill", run, metrics=("fit/train_loss",))
    training_s = time.perf_counter() - begun
    random = {TASK: reinforced.random}
    for task in SHIPPED_TEACHERS:
        random[task] = await evaluate(context, "random actions", task, "random")
    earned = {task: await evaluate(context, "the student", task, {"run": run}) for task in random}
    return Distilled(earned, random, training_s)


def _mean(earned: Mapping[str, Earned]) -> float:
    return sum(each.mean for each in earned.values()) / len(earned)
