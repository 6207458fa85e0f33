"""PPO in the demo: a goal text and images, in; a policy that reaches the goal, out. No label, no state, no reward.

The reward is that of the reward model that came with freerein, learned from noun phrases as the demo learns its own:
so little experience hangs on the reward, and with this one it has been measured over several seeds.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from freerein.cli.demo.context import Context
from freerein.cli.demo.evaluating import Earned, Entrant, finish_evaluations, name_of, start_evaluations
from freerein.cli.demo.runs import finish_run, start_run

TASK = "blocks.yellow-left-of-green"
"""One of those for which the learned reward is precise. That was told by true positions: a choice of what to show."""

REWARD_MODEL = "default"
"""The name of the model that judges; where nobody has fitted another of that name, it is the one that was shipped."""

_RETURN = "episode_return"
_FIRST, _LAST, _UNCHANGED = "first", "last", "unchanged"
_LEARNING = {
    "task": TASK,
    "reward_model": REWARD_MODEL,
    "iterations": 100,
    "num_envs": 16,
    "steps": 32,
    "learning_rate": 1e-3,
    "entropy_weight": 0.0,
    "scale_rewards": True,
}


@dataclass(frozen=True)
class Baselines:
    """What to compare with.

    Attributes:
        random: By task, what random actions earn by the oracle's reward.
        first: What the policy earns before it learns.
    """

    random: Mapping[str, Earned]
    first: Earned


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
    """Starts to measure random actions in tasks, and the policy that is to learn as it is before; returns the run."""
    config = {**_LEARNING, "iterations": 1, "learning_rate": 1e-7, "seed": context.seed}
    unchanged = {"name": _UNCHANGED, "kind": "ppo", "config": config}
    entrants = {name_of(task): Entrant(task, "random") for task in tasks}
    return await start_evaluations(context, entrants | {_FIRST: _policy_of(_UNCHANGED)}, before=[unchanged])


async def finish_baselines(context: Context, run: str, tasks: Sequence[str]) -> Baselines:
    """Returns what is to be compared with."""
    names = [name_of(task) for task in tasks]
    earned = await finish_evaluations(context, "evaluate what there was before", run, [*names, _FIRST])
    return Baselines({task: earned[name_of(task)] for task in tasks}, earned[_FIRST])


async def reinforce(context: Context) -> Reinforced:
    """Learns the policy, and measures it."""
    begun = time.perf_counter()
    run = await start_run(context, "ppo", {**_LEARNING, "seed": context.seed})
    course = await finish_run(context, "ppo", run, metrics=(_RETURN,))
    training_s = time.perf_counter() - begun
    evaluation = await start_evaluations(context, {_LAST: _policy_of(run)})
    earned = await finish_evaluations(context, "evaluate the policy", evaluation, [_LAST])
    return Reinforced(run, course.points(_RETURN), earned[_LAST], training_s)


def _policy_of(run: str) -> Entrant:
    return Entrant(TASK, {"run": run, "is_stochastic": True})
