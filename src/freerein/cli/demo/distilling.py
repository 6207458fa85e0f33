"""Distillation in the demo: rollouts of policies that know one task each, in; a policy that is told in words, out."""

import time
from dataclasses import dataclass

from freerein.cli.demo.context import Context
from freerein.cli.demo.evaluating import Earned, evaluate
from freerein.cli.demo.reinforcing import TASK
from freerein.cli.demo.runs import finish_run, start_run

_ROLLOUTS, _UPDATES = 50, 600


@dataclass(frozen=True)
class Distilled:
    """What came of distillation.

    Attributes:
        earned: What the student, told by a sentence, earns by the oracle's reward.
        training_s: How long the rollouts and the fit took, in seconds.
    """

    earned: Earned
    training_s: float


async def distill(context: Context, teacher: str) -> Distilled:
    """Teaches a language policy what the policy of a ppo run does, and measures it.

    Args:
        context: Where the demo runs.
        teacher: The ppo run's id.
    """
    config = {
        "teachers": [teacher],
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
    return Distilled(await evaluate(context, "the student, told in words", TASK, {"run": run}), training_s)
