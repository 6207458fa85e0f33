"""PPO in the demo: a goal text and images, in; a policy that reaches the goal, out. No label, no state, no reward.

The reward is the reward model's that the demo has learned from noun phrases.
"""

import time
from dataclasses import dataclass

from freerein.cli.demo import rewarding
from freerein.cli.demo.context import Context
from freerein.cli.demo.evaluating import Earned, evaluate
from freerein.cli.demo.runs import finish_run, start_run

TASK = "blocks.yellow-left-of-green"
"""One of those for which the learned reward is precise. That was told by true positions: a choice of what to show."""

STARTS_FROM = ""
"""The policy that came with freerein and is learned on from; empty for weights that know nothing."""

_RETURN = "episode_return"
_LEARNING = {
    "task": TASK,
    "reward_model": rewarding.MODEL,
    "start_from": STARTS_FROM,
    "iterations": 100,
    "num_envs": 16,
    "steps": 32,
    "learning_rate": 1e-3,
    "entropy_weight": 0.0,
    "scale_rewards": True,
}
_UNCHANGED = {**_LEARNING, "iterations": 1, "learning_rate": 1e-7}


@dataclass(frozen=True)
class Reinforced:
    """What came of PPO.

    Attributes:
        run: The run's id.
        curve: By iteration, the mean learned return of the episodes that ended in it.
        random: What random actions earn by the oracle's reward.
        first: What the policy earns before this demo's iterations.
        last: What it earns after.
        training_s: How long it learned, in seconds.
    """

    run: str
    curve: tuple[tuple[int, float], ...]
    random: Earned
    first: Earned
    last: Earned
    training_s: float


async def reinforce(context: Context) -> Reinforced:
    """Learns the policy, and measures it before and after."""
    seed = {"seed": context.seed}
    random = await evaluate(context, "random actions", TASK, "random")
    unchanged = await start_run(context, "ppo", _UNCHANGED | seed)
    await finish_run(context, "ppo, before it learns", unchanged)
    first = await evaluate(context, "the policy before", TASK, {"run": unchanged, "is_stochastic": True})
    if STARTS_FROM:
        context.screen.say(f"PPO goes on from {STARTS_FROM}, which came with freerein.")
    begun = time.perf_counter()
    run = await start_run(context, "ppo", _LEARNING | seed)
    course = await finish_run(context, "ppo", run, metrics=(_RETURN,))
    training_s = time.perf_counter() - begun
    last = await evaluate(context, "the policy after", TASK, {"run": run, "is_stochastic": True})
    return Reinforced(run, course.points(_RETURN), random, first, last, training_s)
