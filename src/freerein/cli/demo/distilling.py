"""Distillation in the demo: rollouts of policies that know one task each, in; a policy that is told in words, out."""

import time
from collections.abc import Mapping
from dataclasses import dataclass

from freerein.cli.demo.context import Context
from freerein.cli.demo.evaluating import Earned, Entrant, finish_evaluations, name_of, start_evaluations
from freerein.cli.demo.reinforcing import TASK
from freerein.cli.demo.runs import finish_run, start_run

SHIPPED_TEACHERS: Mapping[str, str] = {"blocks.yellow-right-of-green": "yellow-right-of-green"}
"""By task, the policies that came with freerein and teach beside the one that the demo has learned."""

TASKS = (TASK, *SHIPPED_TEACHERS)
"""What the student learns."""

_ROLLOUTS, _UPDATES = 50, 600


@dataclass(frozen=True)
class Distilled:
    """What came of distillation.

    Attributes:
        earned: By task, what the student earns by the oracle's reward, told by the task's goal text what to do.
        training_s: How long the rollouts and the fit took, in seconds.
    """

    earned: Mapping[str, Earned]
    training_s: float


async def distill(context: Context, teacher: str) -> Distilled:
    """Teaches a language policy what policies of single tasks do, and measures it in each of these.

    Args:
        context: Where the demo runs.
        teacher: The run that has learned `reinforcing.TASK`.
    """
    config = {
        "teachers": [teacher, *SHIPPED_TEACHERS.values()],
        "rollouts": _ROLLOUTS,
        "num_envs": _ROLLOUTS,
        "is_stochastic": False,  # what the teachers are sure of: the student would have to average noise away
        "seed": context.seed,
        "config": {"steps": _UPDATES},
    }
    begun = time.perf_counter()
    run = await start_run(context, "distill", config)
    await finish_run(context, "distill", run, metrics=("fit/train_loss",))
    training_s = time.perf_counter() - begun
    entrants = {name_of(task): Entrant(task, {"run": run}) for task in TASKS}
    evaluation = await start_evaluations(context, entrants)
    earned = await finish_evaluations(context, "evaluate the student", evaluation, entrants)
    return Distilled({task: earned[name_of(task)] for task in TASKS}, training_s)
