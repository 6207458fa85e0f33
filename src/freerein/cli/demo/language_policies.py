"""PPO on the learned reward, and distillation into one policy that is told in words what to do."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from freerein.cli.demo import reward
from freerein.cli.demo.context import HELD_OUT_SEED, Context
from freerein.cli.demo.pictures import Bar
from freerein.cli.demo.report import Figure
from freerein.metrics import mean_interval

TASKS: Mapping[str, str] = {
    "blocks.yellow-left-of-green": "a yellow block to the left of a green block",
    "blocks.yellow-right-of-green": "a yellow block to the right of a green block",
}
"""Goal text of each task that the student learns. The demo learns the first by PPO.

It was chosen by true positions as one for which the learned reward is precise.
"""

INIT_FROM = "yellow-left-of-green"
"""Shipped policy that PPO starts from: 100 iterations from random weights, on another learned reward."""

SHIPPED_TEACHERS = ("yellow-right-of-green",)
"""Shipped policies that teach beside the one that the demo learns."""

_TASK, _OTHER_TASK = TASKS
_RETURN = "episode_return"
_EPISODES, _ROLLOUTS, _UPDATES = 50, 50, 600
_PPO = {
    "task": _TASK,
    "reward_model": reward.MODEL,
    "iterations": 40,
    "num_envs": 16,
    "steps": 32,
    "lr": 3e-4,
    "entropy_weight": 0.0,
    "scale_rewards": True,
}


@dataclass(frozen=True)
class Returns:
    """Oracle returns of a policy: control steps at the goal, in each of the same episodes for every policy.

    Attributes:
        episodes: One return per episode.
    """

    episodes: tuple[float, ...]

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(np.mean(self.episodes))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mean."""
        return mean_interval(self.episodes, rng=np.random.default_rng(0))

    def minus(self, other: "Returns") -> "Returns":
        """Returns the differences, episode by episode."""
        return Returns(tuple(np.subtract(self.episodes, other.episodes).tolist()))

    def bar(self, name: str) -> Bar:
        """Returns the mean and its interval as a bar."""
        return Bar(name, self.mean, self.interval)


@dataclass(frozen=True)
class Baselines:
    """What the learned policies are compared with.

    Attributes:
        random: Returns of random actions, by task.
        checkpoint: Returns of the shipped policy that PPO starts from.
    """

    random: Mapping[str, Returns]
    checkpoint: Returns


@dataclass(frozen=True)
class PPOResult:
    """A trained policy.

    Attributes:
        run: Id of the run.
        curve: By iteration, the mean learned return of the episodes that ended in it.
        returns: Oracle returns.
        training_s: Duration in seconds.
    """

    run: str
    curve: tuple[tuple[int, float], ...]
    returns: Returns
    training_s: float


@dataclass(frozen=True)
class DistillationResult:
    """A student that is told in words what to do.

    Attributes:
        returns: Oracle returns by task, then by the sentence that the student was told.
        training_s: Duration of rollouts and fit in seconds.
    """

    returns: Mapping[str, Mapping[str, Returns]]
    training_s: float

    def told_the_truth(self) -> Returns:
        """Returns the returns over all tasks, each told its own sentence."""
        return _joined([self.returns[task][text] for task, text in TASKS.items()])

    def word_blind(self) -> Returns:
        """Returns the returns over all tasks when always told the same sentence, the better one."""
        constant = [_joined([self.returns[task][text] for task in TASKS]) for text in TASKS.values()]
        return max(constant, key=lambda returns: returns.mean)


async def start_baselines(context: Context) -> str:
    """Starts to evaluate random actions and the shipped policy; returns the run."""
    frozen = {**_PPO, "iterations": 1, "lr": 1e-7, "seed": context.seed, "start_from": INIT_FROM}
    steps = {"random-left": _evaluation(context, _TASK, "random")}
    steps["random-right"] = _evaluation(context, _OTHER_TASK, "random")
    steps["checkpoint"] = _evaluation(context, _TASK, {"run": "checkpoint-policy", "is_stochastic": True})
    before = {"name": "checkpoint-policy", "kind": "ppo", "config": frozen}
    return await _start_evaluations(context, steps, before)


async def finish_baselines(context: Context, run: str) -> Baselines:
    """Returns the baselines once their run has ended."""
    left, right, checkpoint = await _finish_evaluations(
        context, "evaluate baselines", run, "random-left", "random-right", "checkpoint"
    )
    return Baselines({_TASK: left, _OTHER_TASK: right}, checkpoint)


async def learn_by_ppo(context: Context) -> PPOResult:
    """Trains a policy on images and the learned reward, and evaluates it."""
    context.reporter.line(f"PPO starts from {INIT_FROM}, which came with freerein.")
    started_s = time.perf_counter()
    run = await context.start_run("ppo", {**_PPO, "start_from": INIT_FROM, "seed": context.seed})
    curves = await context.follow_run("ppo", run, metrics=(_RETURN,))
    training_s = time.perf_counter() - started_s
    steps = {"ppo": _evaluation(context, _TASK, {"run": run, "is_stochastic": True})}
    evaluation = await _start_evaluations(context, steps)
    (returns,) = await _finish_evaluations(context, "evaluate ppo", evaluation, "ppo")
    return PPOResult(run, curves.points(_RETURN), returns, training_s)


async def distill(context: Context, teacher: str) -> DistillationResult:
    """Distills the policy of a run and the shipped ones into a language policy; evaluates every sentence in every task.

    Args:
        context: Where the demo runs.
        teacher: Id of the PPO run.
    """
    config = {
        "teachers": [teacher, *SHIPPED_TEACHERS],
        "rollouts": _ROLLOUTS,
        "num_envs": _ROLLOUTS,
        "is_stochastic": False,  # the student would have to average noise away
        "seed": context.seed,
        "config": {"steps": _UPDATES},
    }
    started_s = time.perf_counter()
    run = await context.start_run("distill", config)
    await context.follow_run("distill", run, metrics=("fit/train_loss",))
    training_s = time.perf_counter() - started_s
    cases = [(task, text) for task in TASKS for text in TASKS.values()]
    steps = {
        f"case-{index}": _evaluation(context, task, {"run": run, "goal_text": text})
        for index, (task, text) in enumerate(cases)
    }
    evaluation = await _start_evaluations(context, steps)
    returns = dict(
        zip(cases, await _finish_evaluations(context, "evaluate the student", evaluation, *steps), strict=True)
    )
    return DistillationResult(
        {task: {text: returns[task, text] for text in TASKS.values()} for task in TASKS}, training_s
    )


async def _start_evaluations(context: Context, steps: Mapping[str, dict[str, Any]], *before: dict[str, Any]) -> str:
    """Starts a pipeline of evaluations after other steps; returns the run."""
    evaluations = [{"name": name, "kind": "evaluate", "config": config} for name, config in steps.items()]
    return await context.start_run("pipeline", {"steps": [*before, *evaluations]})


async def _finish_evaluations(context: Context, title: str, run: str, *names: str) -> list[Returns]:
    """Returns the results of a pipeline's evaluations once it has ended."""
    await context.follow_run(title, run)
    results = [await context.artifact(run, f"{name}.result.json") for name in names]
    return [Returns(tuple(result["returns"])) for result in results]


def _evaluation(context: Context, task: str, policy: str | dict[str, Any]) -> dict[str, Any]:
    return {
        "task": task,
        "policy": policy,
        "episodes": _EPISODES,
        "num_envs": _EPISODES,
        "seed": context.seed + HELD_OUT_SEED,
    }


def _joined(parts: list[Returns]) -> Returns:
    return Returns(tuple(value for part in parts for value in part.episodes))


def bars(baselines: Baselines, ppo: PPOResult, student: DistillationResult) -> dict[str, list[Bar]]:
    """Returns the bars of the picture by the title of their panel."""
    own, other = TASKS[_TASK], TASKS[_OTHER_TASK]
    told = student.returns
    return {
        "left of: steps at the goal": [
            baselines.random[_TASK].bar("random"),
            baselines.checkpoint.bar("checkpoint"),
            ppo.returns.bar("ppo"),
            told[_TASK][own].bar('student,\ntold "left"'),
            told[_TASK][other].bar('student,\ntold "right"'),
        ],
        "right of: steps at the goal": [
            baselines.random[_OTHER_TASK].bar("random"),
            told[_OTHER_TASK][other].bar('student,\ntold "right"'),
            told[_OTHER_TASK][own].bar('student,\ntold "left"'),
        ],
    }


def figures(baselines: Baselines, ppo: PPOResult, student: DistillationResult) -> tuple[Figure, ...]:
    """Returns the figures of PPO and of distillation; returns are control steps of 100 at the goal."""
    random, checkpoint = baselines.random[_TASK], baselines.checkpoint
    gain = ppo.returns.minus(checkpoint)
    right, blind = student.told_the_truth(), student.word_blind()
    heard = right.minus(blind)
    by_sentence = [
        Figure(
            f"distill.{task.partition('.')[2]}.told_{'right' if text == own else 'wrong'}",
            f"{task.partition('.')[2]}: student's return, told {'its own' if text == own else 'the other'} sentence",
            student.returns[task][text].mean,
            baselines.random[task].mean,
            "random actions",
            student.returns[task][text].interval,
        )
        for task, own in TASKS.items()
        for text in (own, *(other for other in TASKS.values() if other != own))
    ]
    return (
        Figure(
            "ppo.checkpoint_return",
            "left of: return of the shipped checkpoint that PPO starts from",
            checkpoint.mean,
            random.mean,
            "random actions",
            checkpoint.interval,
        ),
        Figure(
            "ppo.return",
            "left of: return after PPO",
            ppo.returns.mean,
            checkpoint.mean,
            "the checkpoint",
            ppo.returns.interval,
        ),
        Figure(
            "ppo.gain",
            "left of: gained by PPO since the checkpoint, by episode",
            gain.mean,
            0.0,
            "nothing learned",
            gain.interval,
            beats_baseline=True,
        ),
        *by_sentence,
        Figure(
            "distill.return",
            "both tasks: student's return, told each its own sentence",
            right.mean,
            blind.mean,
            "always the same sentence",
            right.interval,
        ),
        Figure(
            "distill.gain_by_words",
            "both tasks: gained by telling it the right sentence, by episode",
            heard.mean,
            0.0,
            "deaf to words",
            heard.interval,
            beats_baseline=True,
        ),
        Figure("ppo.training_s", "PPO, seconds", ppo.training_s),
        Figure("distill.training_s", "distillation, seconds", student.training_s),
    )
