"""PPO in the demo: a goal text and images, in; a policy that reaches the goal, out. No label, no state, no reward.

The reward is the reward model's that the demo has learned from noun phrases.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from freerein.cli.demo import rewarding
from freerein.cli.demo.context import Context
from freerein.cli.demo.evaluating import Earned, Entrant, finish_evaluations, name_of, start_evaluations
from freerein.cli.demo.runs import finish_run, start_run

TASK = "blocks.yellow-left-of-green"
"""One of those for which the learned reward is precise. That was told by true positions: a choice of what to show."""

STARTS_FROM = "yellow-left-of-green"
"""The policy that came with freerein and is learned on from: 100 iterations from weights that know nothing.

The reward was a learned one, too. From scratch, the return after so few differs too much for a demo of minutes.
"""

_RETURN = "episode_return"
_FIRST, _BEGUN, _LAST = "first", "begun", "last"
_LEARNING = {
    "task": TASK,
    "reward_model": rewarding.MODEL,
    "iterations": 40,
    "num_envs": 16,
    "steps": 32,
    "lr": 3e-4,
    "entropy_weight": 0.0,
    "scale_rewards": True,
}


@dataclass(frozen=True)
class Baselines:
    """What to compare with.

    Attributes:
        random: By task, what random actions earn by the oracle's reward.
        first: What weights that know nothing earn.
        begun: What the policy earns that is learned on from.
    """

    random: Mapping[str, Earned]
    first: Earned
    begun: Earned


@dataclass(frozen=True)
class Reinforced:
    """What came of PPO.

    Attributes:
        run: The run's id.
        curve: By iteration, the mean learned return of the episodes that ended in it.
        last: What the policy earns by the oracle's reward.
        training_s: How long it learned, in seconds.
    """

    run: str
    curve: tuple[tuple[int, float], ...]
    last: Earned
    training_s: float


async def start_baselines(context: Context, tasks: Sequence[str]) -> str:
    """Starts to measure random actions in tasks, and policies as they are before they learn; returns the run."""
    config = {**_LEARNING, "iterations": 1, "lr": 1e-7, "seed": context.seed}
    starts = {_FIRST: "", _BEGUN: STARTS_FROM}
    unchanged = [
        {"name": f"{name}-policy", "kind": "ppo", "config": {**config, "start_from": start}}
        for name, start in starts.items()
    ]
    entrants = {name_of(task): Entrant(task, "random") for task in tasks}
    entrants |= {name: _policy_of(f"{name}-policy") for name in starts}
    return await start_evaluations(context, entrants, before=unchanged)


async def finish_baselines(context: Context, run: str, tasks: Sequence[str]) -> Baselines:
    """Returns what is to be compared with."""
    names = [*(name_of(task) for task in tasks), _FIRST, _BEGUN]
    earned = await finish_evaluations(context, "evaluate what there was before", run, names)
    return Baselines({task: earned[name_of(task)] for task in tasks}, earned[_FIRST], earned[_BEGUN])


async def reinforce(context: Context) -> Reinforced:
    """Learns the policy, and measures it."""
    context.screen.say(f"PPO goes on from {STARTS_FROM}, which came with freerein.")
    begun = time.perf_counter()
    run = await start_run(context, "ppo", {**_LEARNING, "start_from": STARTS_FROM, "seed": context.seed})
    course = await finish_run(context, "ppo", run, metrics=(_RETURN,))
    training_s = time.perf_counter() - begun
    evaluation = await start_evaluations(context, {_LAST: _policy_of(run)})
    earned = await finish_evaluations(context, "evaluate the policy", evaluation, [_LAST])
    return Reinforced(run, course.points(_RETURN), earned[_LAST], training_s)


def _policy_of(run: str) -> Entrant:
    return Entrant(TASK, {"run": run, "is_stochastic": True})
